//! Variables by which a program that launches processes tells them how many there are.

/// Variables of the number of processes: Open MPI's, MPICH's and Intel's, Slurm's.
const SIZES: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"];
/// Variables of the number of processes on this node: Open MPI's, MPICH's, Slurm's, which has a list like `4(x2),1`.
const LOCAL_SIZES: [&str; 3] = [
    "OMPI_COMM_WORLD_LOCAL_SIZE",
    "MPI_LOCALNRANKS",
    "SLURM_STEP_TASKS_PER_NODE",
];
/// Variables of the number of a process on its node: Open MPI's, MPICH's, Slurm's.
const LOCAL_RANKS: [&str; 3] = [
    "OMPI_COMM_WORLD_LOCAL_RANK",
    "MPI_LOCALRANKID",
    "SLURM_LOCALID",
];

fn first(names: &[&str], value: impl Fn(&str) -> Option<String>) -> Option<usize> {
    let known = names.iter().filter_map(|name| value(name));
    known.filter_map(|text| text.trim().parse().ok()).next()
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok()
}

/// Number of processes that were launched together, one or more.
#[must_use]
pub fn processes() -> usize {
    first(&SIZES, variable).unwrap_or(1).max(1)
}

/// Number of processes on this node, one or more; of a list of all nodes the most.
#[must_use]
pub fn on_this_node() -> usize {
    most(&LOCAL_SIZES, variable)
}

fn most(names: &[&str], value: impl Fn(&str) -> Option<String>) -> usize {
    let numbers = |text: String| {
        let each = text.split(',').map(|part| {
            let digits = part.trim().split(|c: char| !c.is_ascii_digit());
            digits.into_iter().next().and_then(|n| n.parse().ok())
        });
        each.flatten().max()
    };
    let known = names.iter().filter_map(|name| value(name));
    known.filter_map(numbers).next().unwrap_or(1).max(1)
}

/// Number of this process among those on its node; 0 where nobody says.
#[must_use]
pub fn local_rank() -> usize {
    first(&LOCAL_RANKS, variable).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::{LOCAL_RANKS, LOCAL_SIZES, SIZES, first, most};

    #[test]
    fn the_first_number_counts() {
        let open_mpi = |name: &str| (name == "OMPI_COMM_WORLD_SIZE").then(|| "4".to_owned());
        assert_eq!(first(&SIZES, open_mpi), Some(4));
        assert_eq!(first(&LOCAL_RANKS, open_mpi), None);
        let odd = |name: &str| Some(if name == "PMI_SIZE" { "2" } else { "many" }.to_owned());
        assert_eq!(first(&SIZES, odd), Some(2));
    }

    #[test]
    fn of_a_list_of_nodes_the_most_counts() {
        let said = |text: &'static str| {
            move |name: &str| (name == "SLURM_STEP_TASKS_PER_NODE").then(|| text.to_owned())
        };
        for (text, expected) in [("4(x2),1", 4), ("2,8(x3)", 8), ("3", 3), ("", 1), ("0", 1)] {
            assert_eq!(most(&LOCAL_SIZES, said(text)), expected, "{text:?}");
        }
        assert_eq!(most(&LOCAL_SIZES, |_| None), 1);
    }
}

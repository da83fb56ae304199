//! Figures that ranks count together.

use mhsplat::base::cores::Cores;
use mhsplat::config::Sampler;
use mhsplat::lab::bench::scene::{circle, cloud, dataset};
use mhsplat::ranks::Part;
use mhsplat::scene::morton;
use mhsplat::train::Trainer;
use mhsplat::{Device, Plan};

use super::{nobody, same, shared};
use crate::determinism::{room, sampled, trained};

/// Gradients that are not finite are counted once each, whoever has them.
#[test]
fn ranks_count_what_is_not_finite_once() {
    let data = room(64);
    let mut config = sampled(Sampler::None);
    config.optimizer.lr_sh0 = 1e38;
    // Gradients of 1e18 and more count as not finite.
    config.loss.lambda_opacity = 1e30;
    let (mut alone, _) = trained(&data, &config, 20);
    let want = alone.state();
    let mut together = shared(&data, &config, None, 2);
    together.advance_to(20).unwrap();
    together.count_non_finite().unwrap();
    assert!(alone.non_finite() > 0);
    assert_eq!(together.non_finite(), alone.non_finite());
    let got = together.state();
    assert_eq!(together.non_finite(), alone.non_finite());
    match (got, want) {
        (Ok(got), Ok(want)) => same(&got, &want),
        (got, want) => assert!(got.is_err() && want.is_err()),
    }
    // Those of before a checkpoint count once, too.
    let mut state = trained(&data, &sampled(Sampler::None), 20)
        .0
        .state()
        .unwrap();
    state.non_finite = 1000;
    let mut resumed = shared(&data, &sampled(Sampler::None), None, 2);
    resumed.restore(&state).unwrap();
    resumed.advance_to(25).unwrap();
    resumed.count_non_finite().unwrap();
    assert_eq!(resumed.non_finite(), 1000);
}

/// Rows by layers of height leave their ranks less often than along the Z curve alone.
#[test]
fn layers_keep_gaussians_with_their_bands() {
    let data = dataset(&circle(160));
    let sent = |up: [f32; 3]| {
        let mut config = sampled(Sampler::None);
        (config.iterations, config.sh_degree) = (24, 3);
        let mut plan = Plan::new(&data, &config).unwrap();
        assert_ne!(plan.up, morton::NO_UP);
        plan.up = up;
        let device = Device::open_all(Some("cpu,cpu"), Cores::allowed()).unwrap();
        let splats = cloud(4000).in_morton_order(up);
        let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
        trainer
            .recruit(device.helpers(), &data.train, data.image_budget, nobody)
            .unwrap();
        trainer.advance_to(24).unwrap();
        let sent = trainer.traffic().unwrap();
        sent[Part::Records as usize] + sent[Part::Sums as usize]
    };
    let plan = Plan::new(&data, &sampled(Sampler::None)).unwrap();
    let [curve, layers] = [morton::NO_UP, plan.up].map(sent);
    assert!(
        2 * layers < curve,
        "{layers} bytes, along the curve {curve}"
    );
}

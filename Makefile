# make demo and make test are all a user needs; both set up what is missing first.
VENV := .venv
RUN := $(VENV)/bin

.PHONY: setup test-setup mumps demo test lint docs benchmark attack nightly release clean

setup:
	@bash scripts/setup.sh

test-setup: setup
	@bash scripts/setup.sh tests

mumps: setup
	@bash scripts/mumps.sh

demo: setup
	@$(RUN)/python data/make_connecting_rod.py
	@$(RUN)/morembs reduce pipelines/connecting_rod.toml

# As many workers as cores, so one thread for each. The linters run beside the tests, which leave cores idle while they
# are collected and at their end; what linters say comes last.
test: test-setup
	@words=$$(mktemp); $(MAKE) --no-print-directory lint >$$words 2>&1 & linters=$$!; \
	OPENBLAS_NUM_THREADS=1 $(RUN)/python -m pytest --numprocesses auto --dist worksteal; tests=$$?; \
	wait $$linters; lint=$$?; cat $$words; rm -f $$words; exit $$((tests | lint))

lint: setup
	@$(RUN)/ruff check .
	@$(RUN)/ruff format --check --quiet .
	@$(RUN)/lint-imports
	@$(RUN)/python scripts/imports.py
	@$(RUN)/python scripts/house.py
	@$(RUN)/python scripts/schema.py --check
	@$(RUN)/python benchmarks/figures.py --check
	@$(RUN)/mypy

# The site, in build/site. Pictures of the gallery and what tutorials print are made anew where their programs changed.
PICTURES := $(patsubst pipelines/%,docs/built/pipelines/%.png,$(filter-out pipelines/common,$(basename $(wildcard pipelines/*.py))))

docs: $(PICTURES) docs/built/pipelines/connecting_rod.png
	@$(RUN)/python -m sphinx --fail-on-warning --keep-going --quiet docs build/site
	@echo build/site/index.html

docs/built/pipelines/connecting_rod.png: pipelines/connecting_rod.toml | demo
	@mkdir -p $(@D)
	@cp pipelines/connecting_rod.png $@

docs/built/pipelines/%.png: pipelines/%.py pipelines/common.py | setup
	@MPLBACKEND=agg $(RUN)/python $< --quick --folder $(@D)

# For example: make benchmark CASES="small modes --quick"
benchmark: setup
	@$(RUN)/python benchmarks/run.py $(CASES)

# For example: make attack ARGS="kill --count 1000", or ARGS="damage --count 10000 --seed 7"
attack: setup
	@OPENBLAS_NUM_THREADS=1 $(RUN)/python -m benchmarks.attack $(or $(ARGS),kill)

# Campaigns with new seeds, one hour; build/nightly/index.html shows every night. For example: make nightly ARGS="--hours 8"
nightly: test-setup
	@$(RUN)/python -m benchmarks.nightly $(ARGS)

# sdist, wheel, bill of materials and licenses in dist/, tried in fresh environments.
# For example: make release ARGS="--python python3.11 python3.12 python3.13"
build/release/bin/twine:
	@$(or $(PYTHON),python3) -m venv build/release
	@build/release/bin/pip install --quiet --disable-pip-version-check build twine cyclonedx-bom py-rattler-build

release: build/release/bin/twine
	@build/release/bin/python scripts/release.py $(ARGS)

clean:
	rm -rf $(VENV)

# Two commands do everything on a machine with Python and make: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
ARGS ?=
# Without compiled files kept, each of a run's processes compiles all tests anew: 8 s of a processor.
unexport PYTHONDONTWRITEBYTECODE

# The compiled core.
CORE_C := $(wildcard dbc/*.c estimators/*.c estimators/*/*.c estimators/*/*/*.c gateway/core/*.c sim/*/*.c)
CORE_H := $(wildcard dbc/*.h estimators/*.h estimators/*/*.h estimators/*/*/*.h gateway/core/*.h sim/*.h sim/*/*.h)
WARNINGS := -std=c11 -I. -Wall -Wextra -Wconversion -Wshadow -Werror

.PHONY: demo test test-all fuzz fuzz-deep fuzz-tick soak campaign coverage sanitize mutation lint lint-c lint-python clang format docs bench calibration changelog dist lock clean
demo: $(VENV)/.program
	$(BIN)/traction-gateway demo $(ARGS)

# The tests that need a real SocketCAN interface (tests/hil) run natively, or in user-mode-linux
# where the kernel has none; where neither is possible they are skipped and say why. They run by
# themselves: real time and a busy second core do not go together.
test: $(VENV)/.ready
	$(BIN)/pytest -n auto --dist worksteal --ignore=tests/hil -m "not thorough" $(ARGS)
	$(BIN)/pytest tests/hil -m "not thorough" $(ARGS)

# Before a release: every test, on a core with sanitizers where it can run so, on a real bus, and the
# golden logs on other processors; two hours, and it goes on where it was stopped (tests/release.py).
test-all: $(VENV)/.ready
	-test -d out/labgrid || $(BIN)/pip install -q --target out/labgrid labgrid==26.0.1
	$(PIP) --require-hashes -r requirements-compiler.lock
	$(BIN)/python -m tests.release $(ARGS)

# Random examples, many more of them than the gate looks at: `make fuzz FACTOR=100`.
FACTOR ?= 20
fuzz: $(VENV)/.ready
	$(BIN)/pytest -n auto tests/unit tests/property -m "not slow" --fuzz $(FACTOR) $(ARGS)

# All targets under coverage-guided fuzzing (libFuzzer), SECONDS for each of eight and each seed;
# tests/fuzzing/README.md. atheris has a folder of its own: it is no dependency.
SECONDS ?= 120
SEEDS ?= 1
ATHERIS := out/fuzz/atheris
$(ATHERIS): $(VENV)/.ready
	test -d $(ATHERIS) || $(BIN)/pip install -q --no-deps --target $(ATHERIS) atheris==3.0.0
	$(PIP) --require-hashes -r requirements-compiler.lock
fuzz-deep: $(ATHERIS)
	PYTHONPATH=$(ATHERIS) nice -n 10 $(BIN)/python -m tests.fuzzing --seconds $(SECONDS) \
		--seeds $(SEEDS) -o tests/fuzzing/executions.jsonl $(ARGS)

# Of them the whole tick alone, frames and damaged records, under AddressSanitizer and
# UndefinedBehaviorSanitizer; nothing is kept of the run.
fuzz-tick: $(ATHERIS)
	PYTHONPATH=$(ATHERIS) nice -n 10 $(BIN)/python -m tests.fuzzing --targets tick \
		--seconds $(SECONDS) --seeds $(SEEDS) $(ARGS)

# Three hours of the bus at its worst for each of 100 seeds; some four hours on two cores. It goes on
# where it was stopped; what is in the repository is its last result. ARGS=--anew: on today's code.
soak: $(VENV)/.ready
	$(BIN)/python -m tests.storm --seeds 0-99 --ticks 1000000 -j 2 -o tests/storm/soak.jsonl \
		$(ARGS)

# 500 link downs, 200 deletions, 200 kills, 200 stops and more on a real SocketCAN bus, at random times
# by SEED; half an hour to an hour. The gate does a tenth of each.
SEED ?= 1
campaign: $(VENV)/.ready
	$(BIN)/pytest tests/hil/test_vcan_campaign.py tests/hil/test_vcan_faults.py --require-vcan \
		--counts full --campaign-seed $(SEED) -o timeout=7200 -rP $(ARGS)

# Every line and branch of what decides a flag is run by its own tests; a gate in CI.
coverage: out/core/coverage/sitecustomize.py
	$(BIN)/python -m tests.core_variants coverage -n auto --dist worksteal -m "not thorough"
	$(BIN)/python -m tests.mutation.coverage_gate

# Hostile input to the core under AddressSanitizer and UndefinedBehaviorSanitizer.
sanitize: out/core/sanitize/sitecustomize.py
	$(BIN)/python -m tests.core_variants sanitize -n auto --dist worksteal $(ARGS)

# The core built for them: `make -j 2` of both takes half the time.
out/core/%/sitecustomize.py: $(VENV)/.ready $(CORE_C) $(CORE_H)
	$(BIN)/python -m tests.core_variants build $*

# Are these tests tested? Some 40 minutes. What survives is listed, and all is kept.
# cosmic-ray, which makes the mutants of Python, has an environment of its own: it is no dependency.
MUTANTS := out/mutants
mutation: $(VENV)/.ready
	mkdir -p $(MUTANTS)
	test -d $(MUTANTS)/own || { $(PYTHON) -m venv $(MUTANTS)/own && \
		$(MUTANTS)/own/bin/pip install -q cosmic-ray==8.7.0; }
	$(MUTANTS)/own/bin/python tests/mutation/mutants.py dbc/spec.py >$(MUTANTS)/spec.jsonl
	nice -n 10 $(BIN)/python -m tests.mutation.spec $(MUTANTS)/spec.jsonl
	$(BIN)/python -m tests.mutation.core

# The documents as a site, in out/site; NO_MKDOCS_2_WARNING: an advertisement of its theme's authors.
docs: $(VENV)/.ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build $(ARGS)

# `make -j 2 lint` has the C and the Python of it on a processor each.
lint: lint-c lint-python
lint-c: $(VENV)/.ready
	$(BIN)/clang-format --dry-run -Werror $(CORE_C) $(CORE_H)
	! command -v gcc >/dev/null || gcc $(WARNINGS) -fsyntax-only $(CORE_C)
	$(BIN)/clang-tidy --quiet $(CORE_C) -- $(WARNINGS)
	$(BIN)/cppcheck --quiet --std=c11 -I. --error-exitcode=1 --enable=warning,style,performance,portability $(CORE_C)
lint-python: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m dbc.generate --check
	$(BIN)/python -m tests.docs.prose

# A second compiler, the clang in ziglang, with the same warnings; a minute.
clang: $(VENV)/.ready
	$(PIP) --require-hashes -r requirements-compiler.lock
	mkdir -p out/clang
	for source in $(CORE_C); do $(BIN)/python -m ziglang cc $(WARNINGS) -O1 -c $$source -o out/clang/core.o \
		|| exit 1; done

format: $(VENV)/.ready
	$(BIN)/clang-format -i $(CORE_C) $(CORE_H)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# hilspy, a peer to compare with, has a folder of its own: it is no dependency, and may be missing.
PEERS := out/bench/peers
bench: $(VENV)/.ready
	-test -d $(PEERS) || $(BIN)/pip install -q --no-deps --target $(PEERS) hilspy==0.16.0
	PYTHONPATH=$(PEERS) $(BIN)/python -m bench -o docs/performance.md $(ARGS)

# The calibration of the simulated bench motors that ships with the package.
calibration: $(VENV)/.ready
	for duty in cool warm hot; do \
		$(BIN)/traction-gateway sim calibration_$$duty -o out/calibration_$$duty.log; done
	$(BIN)/traction-gateway calibrate out/calibration_*.log --config examples/train16.toml \
		-o gateway/bench_calibration.toml

# Wheels for two processors (glibc 2.17 or newer, any Python from 3.11 on), and the sdist. What an earlier
# build left would otherwise be packed as well.
ZIG = $(abspath $(BIN))/python -m ziglang cc -target $$what-linux-gnu.2.17 -I$(abspath out/sizes)
dist: $(VENV)/.ready
	rm -rf build dist
	$(PIP) --require-hashes -r requirements-compiler.lock
	$(BIN)/python -c "import core_build; core_build.build_sdist('dist'); core_build.leave_sizes('out/sizes')" >/dev/null
	for what in x86_64 aarch64; do rm -rf build; CC="$(ZIG)" LDSHARED="$(ZIG) -shared" \
		$(BIN)/python setup.py -q bdist_wheel --plat-name manylinux2014_$$what -d dist || exit 1; done
	ls dist

# What stands in changelog.d goes into CHANGELOG.md, under the version in pyproject.toml. towncrier has
# an environment of its own: it is no dependency.
changelog:
	test -d out/towncrier || { $(PYTHON) -m venv out/towncrier && \
		out/towncrier/bin/pip install -q towncrier==26.9.0; }
	out/towncrier/bin/towncrier build --yes --version $$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)

# Only with a new dependency: needs uv (pip install uv). The demo's lock is a part of the whole one. Extras
# stay in a lock: what is asked for with one, and pinned without, pip takes in its newest version, of which
# there is no hash.
COMPILE := uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--no-strip-extras --no-emit-index-url --quiet
lock:
	$(COMPILE) --extra dev --output-file requirements.lock
	$(COMPILE) --extra pictures --group build --constraints requirements.lock \
		--output-file requirements-demo.lock

PIP := $(BIN)/pip install --quiet --disable-pip-version-check

# Runs a command that may print nothing for a minute: on a terminal the seconds are counted.
define counted
@echo '$(1)'
@if [ -t 1 ]; then (n=0; while sleep 1 && kill -0 $$$$; do n=$$((n + 1)); printf '%s s\r' $$n; done) \
	2>/dev/null & fi; $(1)
endef

# A machine without a C compiler gets one from pip.
$(VENV)/.libraries: requirements-demo.lock requirements-compiler.lock
	$(call counted,$(PYTHON) -m venv $(VENV))
	$(call counted,$(PIP) --require-hashes -r requirements-demo.lock)
	$(call counted,command -v cc >/dev/null || $(PIP) --require-hashes -r requirements-compiler.lock)
	touch $@

# compat: a path in a .pth file; the other way of an editable install costs every start an import.
$(VENV)/.program: $(VENV)/.libraries pyproject.toml setup.py core_build.py $(CORE_C) $(CORE_H)
	$(call counted,$(PIP) --no-deps --no-build-isolation --config-settings editable_mode=compat -e .)
	touch $@

$(VENV)/.tools: requirements.lock | $(VENV)/.program
	$(call counted,$(PIP) --require-hashes -r requirements.lock)
	touch $@

# What the program needs is enough for `make demo`; all else has the tests' tools beside it.
$(VENV)/.ready: $(VENV)/.tools $(VENV)/.program
	touch $@

clean:
	rm -rf $(VENV) build dist out *.egg-info _traction_core*.so

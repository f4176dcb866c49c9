# Every target makes .venv first when it is missing: a fresh clone needs Python >= 3.11 and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Threads of the linear algebra fight the tests' processes for the same cores.
export OMP_NUM_THREADS ?= 1

.PHONY: demo test long hardest quick check installed bench docs clean

demo: $(STAMP)
	$(BIN)/linkplan demo -o linkplan-demo

test: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist loadfile

# The tests of tests/long.txt, which take more than about half a second each: pages of the documents, large models.
long: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal --long

# The hardest published problems and largest mechanisms: ten minutes of processor time.
hardest: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal --hardest

quick: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not slow"

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/python -m tests.bench.source_sizes

# What a stranger gets: sdist and wheel, the wheel alone in an empty environment, and its commands in an empty folder.
STRANGER := $(CURDIR)/build/stranger
installed: $(STAMP)
	rm -rf $(STRANGER)
	mkdir -p $(STRANGER)/empty
	$(BIN)/python -m build --outdir $(STRANGER)/dist . > $(STRANGER)/build.log 2>&1 || { cat $(STRANGER)/build.log; exit 1; }
	$(PYTHON) -m venv $(STRANGER)/venv
	$(STRANGER)/venv/bin/python -m pip install --quiet --disable-pip-version-check $(STRANGER)/dist/*.whl
	cd $(STRANGER)/empty && PATH="$(STRANGER)/venv/bin:$$PATH" && linkplan check optimus-knee && \
	  linkplan plan knee-reach -o plan && linkplan report plan -o report.html && \
	  python -c "import linkplan; assert linkplan.read_plan('plan').passed" && test -s report.html
	du -sm $(STRANGER)/dist/* $(STRANGER)/venv

# `make bench` runs all parts, `make bench rounding` the part named; the names that follow are no targets of their own.
ifeq (bench,$(firstword $(MAKECMDGOALS)))
PARTS := $(wordlist 2,$(words $(MAKECMDGOALS)),$(MAKECMDGOALS))
.PHONY: $(PARTS)
$(PARTS): bench ;
endif

bench: $(STAMP)
	$(BIN)/python -m tests.bench $(PARTS)

# Every page of docs/, its notebooks executed; a warning, a link that leads nowhere among them, is an error.
docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going docs build/site
	@echo "the site is in build/site/, begin with build/site/index.html"

clean:
	rm -rf $(VENV) build *.egg-info linkplan-demo bench-results

$(STAMP): pyproject.toml
	$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else f"linkplan needs Python 3.11 or newer, $(PYTHON) is {v[0]}.{v[1]}; say make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade pip
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $(STAMP)

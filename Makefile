# Two commands on a fresh machine with Python 3.11 and make:
#   make compare   set up and run the main job
#   make test      set up and check what guards a change, within ten minutes
#   make test-all  that, and what is slow by nature: browser, whole studies, long searches
#   make search    the searches ten times longer: hours
#   make test-versions  the tests with the lowest and the newest versions allowed, and pre-releases
#   make site      the documentation as a site in build/site
#   make paper     two pages to cite: build/paper/paper.pdf (needs chromium)
#   make laws      measure all shipped laws and refresh their tables in docs: an hour
#   make report    set up and reproduce the report on one page: out/report/report.html
# Both build .venv from constraints.txt. The plain pip lines are in the README.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= auto
# Several threads of linear algebra on busy cores wait for each other, up to 40 times.
export OPENBLAS_NUM_THREADS = 1
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --durations 40 --durations-min 1

.PHONY: compare laws report test test-all test-versions lint types imports links tests slow search site paper constraints clean

compare: $(VENV)/ready
	$(BIN)/cmf compare

LAWS := velocity,velocity_tuned,dynamic_pressure,acceleration_compensated,feed_forward,modal_feedback

laws: $(VENV)/ready
	mkdir -p out
	printf 'base = "hardware"\n\n[constant]\nsupply = "constant"\n' > out/constant.toml
	$(BIN)/cmf compare
	$(BIN)/cmf compare --laws all --hydraulics report --plants single_legs --dofs heave --out out/report-heave
	$(BIN)/cmf compare --laws all --hydraulics out/constant.toml --out out/all
	$(BIN)/python scripts/laws.py confirm --laws $(LAWS),modal_plan --seeds 1 --quick --out out/field_confirm
	$(BIN)/python scripts/laws.py confirm --seeds 1 --quick --noise --out out/modal_plan
	$(BIN)/python scripts/laws.py linear
	$(BIN)/python scripts/laws.py accept
	$(BIN)/python scripts/laws.py fly
	$(BIN)/python scripts/laws.py ablate
	$(BIN)/python scripts/laws.py stiffness
	$(BIN)/python scripts/update_docs.py

report: $(VENV)/ready-report
	$(BIN)/cmf report

test: lint types imports links tests

test-all: test slow

lint: $(VENV)/ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/ready-dev
	$(BIN)/mypy

imports: $(VENV)/ready-dev
	$(BIN)/lint-imports

# In three parts, so that a worker, which never gives all memory back, stays below 1 GB.
tests: $(VENV)/ready-dev
	$(PYTEST) --dist worksteal -m "not slow" tests/[a-d]*/
	$(PYTEST) --dist worksteal -m "not slow" tests/[e-q]*/
	$(PYTEST) --dist worksteal -m "not slow" tests/[r-z]*/
	$(PYTEST) --dist loadfile README.md docs models

slow: $(VENV)/ready-dev
	$(PYTEST) --dist worksteal -m "slow or fuzz" --hypothesis-profile long tests

# Afresh each time, so that no page or module that is gone can satisfy a link. The check resolves
# every link and reference as the site does and writes no pages. One process: two take twice the
# time of both, to hand each other what they read.
SPHINX = rm -rf docs/reference/api docs/gallery build/$@ && $(BIN)/sphinx-build --quiet --fail-on-warning --keep-going

search: $(VENV)/ready-dev
	$(PYTEST) --dist worksteal -m fuzz --hypothesis-profile whole tests
	$(BIN)/python scripts/simulate_faults.py --seed 1000 --minutes 10

PYTHONS ?= 3.11 3.12 3.13

# Environments of their own in build/versions; `pre` only tells.
test-versions:
	$(PYTHON) scripts/check_versions.py lowest newest pre --pythons $(PYTHONS)

links: $(VENV)/ready-dev
	$(SPHINX) --builder dummy -D plot_gallery=0 -D smartquotes=0 docs build/links

site: $(VENV)/ready-dev
	$(SPHINX) docs build/site

paper: $(VENV)/ready-dev
	$(SPHINX) -D plot_gallery=0 docs build/paper
	chromium --headless --no-sandbox --no-pdf-header-footer --print-to-pdf=build/paper/paper.pdf \
	  build/paper/explanation/paper.html

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/ready: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/ready-%: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[$*]'
	touch $@

# Pin what the newest allowed versions resolve to today.
constraints:
	$(PYTHON) -m venv $(VENV)-fresh
	$(VENV)-fresh/bin/python -m pip install --quiet '.[dev]'
	$(VENV)-fresh/bin/python -m pip freeze --exclude cmf-mj > constraints.txt
	rm -rf $(VENV)-fresh

clean:
	rm -rf $(VENV) out build dist

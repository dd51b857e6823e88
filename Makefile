# `make demo` and `make test` work on a bare machine with Python 3.11 or newer: they create .venv and install what is
# missing, in the versions of constraints.txt. For another Python than the first one found:
# `make PYTHON=python3.13 VENV=.venv-3.13 test`.
# `make demo` needs no torch. `make test` and `make check` do: on Linux, point PIP_EXTRA_INDEX_URL to PyTorch's index of
# CPU builds to be spared most of the CUDA packages; numba-cuda needs 0.2 GB of them.

SUPPORTED := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3.14 python3 python; do \
	$$p -c '$(SUPPORTED)' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
METHODS := --editable methods/relational --editable methods/goals --editable methods/intents
# Without --no-compile, pip compiles 20,000 modules, of which Python would import few.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
# Processes keep what they compile: without that, each one that imports PyTorch takes 2 s more.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test fast bench peers leaderboard check format docs readme demonstrations lerobot integrations-test constraints notebooks release-check system site site-test site-test-firefox site-audit site-picture site-looks policies node chromium firefox xvfb

demo: $(VENV)/.installed-all  ## evaluate the expert, random and no-op agent in all environments; the report is out/demo/report.md
	$(BIN)/magical-mj demo

test: $(VENV)/.installed-dev  ## run the tests; ARGS="-k scene" selects some, ARGS="-m weekly" those that CI runs each week
	$(BIN)/python -m pytest -n auto --maxprocesses 8 --dist loadgroup --junit-xml=out/tests.xml $(ARGS)

fast: $(VENV)/.installed-dev  ## the tests that take under a minute: no processes, no training
	$(BIN)/python -m pytest -n auto --maxprocesses 8 -m "not slow and not weekly" tests/scene tests/variants tests/tasks tests/engine $(ARGS)

bench: $(VENV)/.installed-dev  ## measure speed
	$(BIN)/python -m tools.benchmarks $(ARGS)

peers: .venv-peers/.installed  ## the speed of other benchmarks beside ours, in an environment of its own
	.venv-peers/bin/python tools/benchmarks/peers.py --picture docs/speed.png $(ARGS)

.venv-peers/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet --editable . ale-py envpool gym-pusht matplotlib minigrid pymunk
	@touch $@

leaderboard: $(VENV)/.installed-dev  ## check the entries in results/, REPLAY=10: so many episodes of each, and make out/leaderboard
	$(BIN)/magical-mj leaderboard results --out out/leaderboard $(REPLAY:%=--replay %) $(ARGS)
	$(BIN)/python -m tools.intent_baselines check

check: $(VENV)/.installed-dev  ## lint and type check
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

format: $(VENV)/.installed-dev  ## format, and fix what can be fixed
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

docs: $(VENV)/.installed-dev  ## rewrite the pictures and the tables of the README and of docs/
	$(BIN)/magical-mj view --grid --size 112 --out docs/environments.png --force
	$(BIN)/magical-mj view FindDupe --camera scene,ego --size 400 --out docs/scene.png --force
	rm -rf out/models
	$(BIN)/magical-mj export FindDupe Demo --out out/models
	$(BIN)/magical-mj export FixColour All --seed 2 --out out/models
	$(BIN)/magical-mj export ClusterShape Demo --out out/models
	$(BIN)/magical-mj export MatchRegions All --seed 4 --out out/models
	$(BIN)/python tools/exported_models.py out/models docs/exported-models.png
	$(BIN)/python tools/experts_picture.py
	$(BIN)/python -m tools.architecture_picture
	$(BIN)/python tools/shifts.py picture
	$(BIN)/python tools/research/physics_picture.py
	$(BIN)/python -m tools.tables

site: $(VENV)/.installed-dev | node  ## the documentation and the page to play on, in out/site; SITE_URL, SITE_REPOSITORY: their addresses
	PYTHONPATH=.:site $(BIN)/python site/docs.py
	PYTHONPATH=.:site $(BIN)/python site/play.py

site-test: site | chromium  ## the site in headless Chromium, and its simulation and scores beside Python's
	$(BIN)/python site/fetch.py
	$(BIN)/python site/tests/cases.py out/site-test
	node --test --test-concurrency=1 --test-reporter=spec site/tests/
	$(BIN)/python site/tests/saved.py out/site-test
	$(BIN)/python site/tests/words.py
	$(BIN)/python site/study.py

site-test-firefox: site | firefox  ## the pages in Firefox: those around the simulation, play and inspect
	$(BIN)/python site/fetch.py
	$(BIN)/python site/tests/cases.py out/site-test
	BROWSER=firefox LIBGL_ALWAYS_SOFTWARE=1 xvfb-run -a node --test --test-concurrency=1 --test-reporter=spec \
		site/tests/pages.test.mjs site/tests/play.test.mjs site/tests/inspect.test.mjs site/tests/editor.test.mjs

site-audit: site | chromium  ## Lighthouse's figures of the site, a page of each kind, how soon and smoothly one plays and inspects, and their memory
	$(BIN)/python site/fetch.py
	npm install --silent --no-audit --no-fund --prefix out/audit lighthouse@13.5.0
	node site/audit.mjs
	node site/speed.mjs
	node site/memory.mjs

site-picture: site | chromium  ## docs/site.png and docs/inspect.png, anew
	$(BIN)/python site/fetch.py
	$(BIN)/python site/screenshots.py

site-looks: site | chromium  ## pictures of the site's pages in three widths, light and dark, in out/looks: to be looked at
	$(BIN)/python site/fetch.py
	node site/looks.mjs out/looks

policies: $(VENV)/.installed-dev  ## the policies that act in the site: trained, exported to site/policies, and scored there
	$(BIN)/python site/policies.py

readme: $(VENV)/.installed-dev  ## run README.md in a new environment that has only what the page tells to install
	$(BIN)/python tools/readme_run.py

demonstrations: $(VENV)/.installed-dev  ## after a change of the physics: the shipped demonstrations, docs/experts.md and the site's episodes, anew
	$(BIN)/magical-mj demos generate --count 25 --out out/demonstrations
	$(BIN)/python tools/pack_demonstrations.py out/demonstrations
	$(BIN)/python -m tools.graded_demonstrations
	rm -rf out/experts
	$(BIN)/magical-mj evaluate --policy expert --episodes 20 --out out/experts
	$(BIN)/python tools/experts.py out/experts

integrations-test: $(VENV)/.installed-dev  ## other libraries with this package, LIBRARY=torchrl, several, all, or turn: two of them, others each day
	$(BIN)/python -m tools.integrations $(or $(LIBRARY),turn)

lerobot:  ## an environment of its own (Python 3.12, 6.3 GB) in which LeRobot's commands know this package
	$(or $(PYTHON),python3) -m tools.integrations --install lerobot

release-check: $(VENV)/.installed-release  ## build the wheel and the sdist in dist/, and check them, the changelog and the tag
	rm -rf dist
	$(BIN)/validate-pyproject pyproject.toml
	$(BIN)/python -m build --no-isolation --outdir dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/python tools/release.py $(TAG)

notebooks: $(VENV)/.installed-notebooks  ## run examples/notebooks, and keep what they show
	$(BIN)/python tools/notebooks.py

constraints:  ## write constraints.txt: the newest versions that a fresh environment gets today
	$(PYTHON) -m venv $(VENV)-new
	$(VENV)-new/bin/python -m pip install --quiet 'pip>=25.1'
	$(VENV)-new/bin/python -m pip install --quiet --editable . --group dev 'torch==2.13.0'
	{ echo "# The versions that the tests ran with; make and CI install through this file. Written by make constraints."; \
	$(VENV)-new/bin/python -m pip freeze --exclude-editable | sed 's/+cpu$$//'; } > constraints.txt
	rm -r $(VENV)-new

$(VENV)/.installed-all: pyproject.toml constraints.txt magical_mj/_version.py $(BIN)/python | system
	@echo "installing magical-mj[all] into $(VENV) ..."
	@$(INSTALL) --editable '.[all]'
	@touch $@

$(VENV)/.installed-%: pyproject.toml constraints.txt $(wildcard methods/*/pyproject.toml) magical_mj/_version.py $(BIN)/python | system
	@echo "installing magical-mj for $* into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile 'pip>=25.1' # the first with --group
	@$(INSTALL) --editable . $(if $(filter dev,$*),$(METHODS)) --group $*
	@touch $@ $(if $(filter dev,$*),$(VENV)/.installed-all)

$(BIN)/python: | system
	$(PYTHON) -m venv $(VENV)

node chromium firefox xvfb:
	@tools/system.sh $(PYTHON) $@

system:
	@$(or $(PYTHON),false) -c '$(SUPPORTED)' || { \
		echo "magical-mj needs Python 3.11 or newer; call make with PYTHON=/path/to/python3.11" >&2; exit 1; }
	@tools/system.sh $(PYTHON)

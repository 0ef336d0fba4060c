# Targets of this project. Each works in a clean shell, with or without an installed ROS 2.
#
#   make build      the ROS 2 environment and what changed in the workspace
#   make demo       the rig tracks a simulated drone; DEMO="scenario:=circle duration:=60" for another scenario, VIEW=1 for a page
#   make test       all tests; TESTS="src/av_audio/test -k delay" for some
#   make report     the publication's experiments, with our results (QUICK=1: one run of each; SEEDS=n, DATA=folder)
#   make detector   every figure of a detector's model card, COCO's beside it (QUICK=1: a fifth; MODEL=file, CACHE=folder for 9 GB, DATA=folder)
#   make docs       the documents as a site, build/docs/html/index.html
#   make lint       style, types, layers of packages, package.xml files, links, sentences and commands of documents, shell scripts
#   make distributions   imports all packages with the Python and libraries of each distribution; wheels for 64-bit ARM
#   make clean      remove the output of build and tests; make distclean: also the assembled ROS 2 environment

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.PHONY: build demo test report detector distributions docs lint layers packages documents clean distclean
.DEFAULT_GOAL := build

ENV := . tools/ros_env.sh
DEMO ?= duration:=$(if $(VIEW),300,40)
VIEW ?=
TESTS ?=
QUICK ?=
SEEDS ?= 0
DATA ?= ../shared/data
MODEL ?= src/av_vision/models/drone_detector.onnx
CACHE ?= results/detector_cache

build:
	$(ENV) && python3 tools/build.py

demo: build
	$(ENV) && exec ros2 launch av_fusion rig.launch.py $(DEMO) $(if $(VIEW),view:=true view_control:=true bags:=results/bags)

test: build
	python3 tools/ros_env/prerequisites.py
	$(ENV) && exec python3 -m pytest -n auto --dist loadgroup --no-loadscope-reorder $(TESTS)

# Without QUICK, it also updates the README's table of measured values.
report: build
	$(ENV) && exec ros2 run av_evaluation report --data $(DATA) --seeds $(SEEDS) \
		$(if $(QUICK),--quick --out results/report_quick,--readme README.md --out results/report)

detector: build
	$(ENV) && exec python3 training/detector/evaluate.py $(MODEL) --cache $(CACHE) --data $(DATA)/drone_detection \
		--coco $(DATA)/models/yolox_nano_coco.onnx $(if $(QUICK),--quick)
	$(ENV) && exec python3 training/detector/evaluate.py $(dir $(MODEL))drone_detector_ir.onnx --only thermal --cache $(CACHE) \
		--data $(DATA)/drone_detection --coco $(DATA)/models/yolox_nano_coco.onnx $(if $(QUICK),--quick)

# Needs no build and no ROS.
distributions:
	python3 tools/distributions/wheels.py
	python3 tools/distributions/check.py

# With the names, parameters and messages of all packages; the first time it installs Sphinx there.
docs: build
	$(ENV) && python3 tools/docs/make_site.py

# Needs no build. Rules and exceptions are in pyproject.toml. Workflows are checked if actionlint is installed.
lint: layers packages documents
	$(ENV) && ruff check .
	$(ENV) && mypy
	for script in tools/*.sh .ci/run; do bash -n "$$script"; done
	if command -v actionlint >/dev/null; then actionlint; fi

# Permitted imports between packages.
layers:
	$(ENV) && PYTHONPATH="$$(printf '%s:' src/av_*)$${PYTHONPATH-}" lint-imports --no-logo --no-cache

# Check that package.xml and setup.py are valid, complete and of one version.
packages:
	$(ENV) && python3 -c 'import sys; from catkin_pkg.package import parse_package as p; [p(f) for f in sys.argv[1:]]' src/*/package.xml
	$(ENV) && python3 tools/lint/package_dependencies.py src/*
	$(ENV) && python3 tools/lint/metadata.py src/*

# Links lead to files and headings that exist, sentences are short, and commands can be typed.
documents:
	$(ENV) && python3 tools/lint/links.py
	$(ENV) && python3 tools/lint/sentences.py
	$(ENV) && python3 tools/lint/commands.py

clean:
	rm -rf build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis src/*/*.egg-info src/*/*/nodes/*_parameters.py
	find src launch test tools -name __pycache__ -prune -exec rm -rf {} +

distclean: clean
	rm -rf .ros

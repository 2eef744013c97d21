# taxinet_ros from a bare machine to a run: Python 3.11 to 3.13, a C and C++ compiler and make are
# all it takes. No ROS installation is needed or used; ROS 2 Jazzy comes as wheels into .venv.
#
#   make          install into .venv             make test       the tests
#   make demo     install and run the demo       make nightly    the long tests: stress, soak, fuzz
#   make format   fix what ruff can fix        make lint       style, types, import rules
#   make bench    times, ratios to bench.json    make clean      remove caches and build folders
#   make docs     the site into build/docs       make distclean  the same, and .venv
#   PYTHON=python3.12   Python to make .venv with     PYTEST='-k steering'   arguments for pytest
#   OUT=bags/demo       where the demo's bags go      VENV=.venv             where to install
#   JOBS=3              tests side by side, else three for two cores; 0: one after the other,
#                       in one process
#   REPEATS=10          how often make bench measures, in turns
#   HASHES=yes          of what is pinned, install the very files of hashes.txt, tools included
#   CONSTRAINTS=constraints-noble.txt   versions that fit those of Ubuntu 24.04
#
# On Linux the default index serves torch with CUDA, some GB. Without a GPU, make adds the index of
# PyTorch's CPU wheels, where it answers and neither PIP_EXTRA_INDEX_URL nor pip's configuration names
# another: the pinned version is the same, and pip then prefers the small build. TORCH=any leaves the
# choice to pip.

PYTHON ?= python3 python3.13 python3.12 python3.11
VENV ?= .venv
OUT ?= bags/demo
PYTEST ?=
JOBS ?= logical
HASHES ?=
CONSTRAINTS ?= constraints.txt
TORCH ?=
REPEATS ?= 10

BIN := $(VENV)/bin
DONE := $(VENV)/done
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALL := $(PIP) install -q -c $(CONSTRAINTS)
# The requirements are whole without their own; what is not pinned, CUDA's libraries, follows later.
VERIFIED := $(PIP) install -q --no-deps --require-hashes -r
# Without a GPU, the small build of torch, if its index answers within seconds; hashes name files.
CPU_TORCH := https://download.pytorch.org/whl/cpu
ASK := import sys, urllib.request; urllib.request.urlopen(sys.argv[1] + "/torch/", timeout=10)
CHOOSE_TORCH = if [ -z "$(TORCH)$(HASHES)$${PIP_EXTRA_INDEX_URL:-}" ] && [ "$$(uname)" = Linux ] && \
  [ ! -e /dev/nvidiactl ] && [ ! -e /dev/kfd ] && \
  ! $(PIP) config list 2>/dev/null | grep -Eq 'index|find-links'; then \
    if $(BIN)/python -c '$(ASK)' '$(CPU_TORCH)' 2>/dev/null; then \
      echo 'make: no GPU here: torch for CPUs, from $(CPU_TORCH) (TORCH=any: the default index)'; \
      export PIP_EXTRA_INDEX_URL='$(CPU_TORCH)'; \
    else echo 'make: no GPU here, but $(CPU_TORCH) does not answer: torch as pip finds it'; fi; fi
# pip is silent while it downloads and unpacks; this tells every 20 s that it works, for as long as
# the recipe's shell is there, however that ends.
BEAT = { while sleep 20 > /dev/null 2>&1 && kill -0 $$$$ 2> /dev/null; do \
  echo "make: still installing; $$(du -sh $(VENV) 2>/dev/null | cut -f1) in $(VENV) so far"; done & } ; \
  beat=$$!; trap 'kill '$$beat' 2>/dev/null' EXIT
CACHES := .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
SHARED := $(wildcard scripts/* launch/* config/* scenarios/* scenarios/*/*) resource/taxinet_ros
NATIVE := $(wildcard taxinet_ros/core/camera/native/*)
INTERFACES := $(wildcard msg_defs/* msg_defs/*/* msg_defs/*/*/*)

# One ROS at a time: what a sourced installation, or another environment's Python, has left in the
# shell would mix its libraries with those in .venv.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH
unexport RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Tests start a thousand processes; without bytecode each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE
export PIP_ROOT_USER_ACTION := ignore

.PHONY: install demo test nightly bench docs lint format clean distclean asked-python own
.NOTPARALLEL:

install: $(DONE)/messages
	@echo 'taxinet_ros is installed in $(VENV); next: make demo, or $(BIN)/taxinet --help'

demo: $(DONE)/messages
	@echo '$(BIN)/taxinet demo --out $(OUT)'
	@$(BIN)/taxinet demo --out $(OUT)

# Message setters then check types and ranges; else a wrong value is cut to size in silence.
test nightly: export ROS_PYTHON_CHECK_FIELDS := 1
test: TIER := not nightly
nightly: TIER := nightly
test nightly: $(DONE)/messages $(DONE)/tools
	$(BIN)/python -m pytest -m '$(TIER)' -n $(JOBS) --maxprocesses 8 --dist loadfile \
	  --no-loadscope-reorder $(PYTEST)

# A report, for the machine is never as quiet as a test would need; it fails when a ratio that does
# not depend on the machine is far off.
bench: $(DONE)/messages
	$(BIN)/taxinet bench --repeats $(REPEATS) --guard --json > bench.json

# Every warning, of a lost link or heading too, fails the build; so does a test.
docs: $(DONE)/messages $(DONE)/tools
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs
	@echo 'the site is in build/docs/index.html'

lint: $(DONE)/messages $(DONE)/tools
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: $(DONE)/tools
	$(BIN)/ruff check --fix .

clean:
	rm -rf build install log taxinet_ros.egg-info $(CACHES)

distclean: clean
	rm -rf $(VENV) taxinet_ros/core/camera/pixels.*.so

# An interpreter is fit when it can make an environment and has the headers to compile against.
FIT := import ensurepip, os, sys, sysconfig, venv; \
  header = os.path.join(sysconfig.get_path("include"), "Python.h"); \
  sys.exit(not ((3, 11) <= sys.version_info[:2] <= (3, 13) and os.path.exists(header)))

ifneq ($(HASHES),)
ifneq ($(CONSTRAINTS),constraints.txt)
$(error HASHES names the files of constraints.txt, not of $(CONSTRAINTS): leave one of them out)
endif
endif

ifeq ($(origin PYTHON),command line)
$(DONE)/venv: | asked-python
endif

# Of one interpreter that was asked for, its own words say more than a list of those that are unfit.
ASKED := import os, sys, sysconfig; \
  print("Python %d.%d" % sys.version_info[:2], end=""); \
  (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.exit(", not 3.11 to 3.13"); \
  import ensurepip, venv; \
  header = os.path.join(sysconfig.get_path("include"), "Python.h"); \
  os.path.exists(header) or sys.exit(", has no C headers: " + header + " (python3-dev)")

asked-python:
	@$(if $(word 2,$(PYTHON)),exit 0;) \
	told=$$($(PYTHON) -c '$(ASKED)' 2>&1); code=$$?; \
	case "$$code $$told" in '0 Python 3.'*) ;; *) \
	  case "$$told" in Traceback*) told=$$(printf '%s' "$$told" | tail -1);; esac; \
	  echo 'make: $(PYTHON) ended with exit code' "$$code:" \
	    "$$(printf '%s' "$${told:-it says nothing}" | tr -s '[:space:]' ' ');" \
	    'name a Python 3.11 to 3.13: make PYTHON=/path/to/python3.12' >&2; \
	  exit 2;; \
	esac
	@$(if $(word 2,$(PYTHON)),exit 0;) \
	if [ -x $(BIN)/python ] && [ "$$($(BIN)/python -V)" != "$$($(PYTHON) -V)" ]; then \
	  echo 'make: $(VENV) holds' "$$($(BIN)/python -V), not $(PYTHON);" \
	    'say make distclean first, or VENV=another' >&2; \
	  exit 2; \
	fi

$(DONE)/venv:
	@for compiler in cc c++; do command -v $$compiler >/dev/null || { \
	  echo 'make: no compiler "'$$compiler'" on the PATH; on Debian and Ubuntu: apt install g++' >&2; \
	  exit 2; }; done
	@for python in $(PYTHON) none; do $$python -c '$(FIT)' 2>/dev/null && break; done; \
	if [ $$python = none ]; then \
	  echo 'make: no Python 3.11 to 3.13 with venv and C headers among: $(PYTHON); on Debian and' \
	    'Ubuntu: apt install python3-venv python3-dev; one elsewhere: make PYTHON=/path/to/it' >&2; \
	  exit 2; \
	fi; \
	echo "make: making $(VENV) with $$python ($$($$python -V))"; \
	$$python -m venv $(VENV)
	@$(if $(HASHES),:,$(INSTALL) setuptools)
	@mkdir -p $(DONE) && touch $@

# scenic asks for opencv-python, which unpacks over the headless build's files and wants a display's
# libraries; so the headless one is laid down last.
HEADLESS := import cv2, re, sys; \
  sys.exit(not re.search(r"GUI: +NONE", cv2.getBuildInformation()))

# What the sources in taxinet_ros/core/camera/native ask of a compiler.
MODERN := \#include <bit>\nstatic_assert(std::bit_cast<int>(0.0F) == 0);\n

# The environment of another checkout, by a link or VENV, would test that one's code, or from now on
# run this one's. Asked at every call, also when there is nothing to install.
OWNER := import json, pathlib, sys; from importlib import metadata; \
  text = metadata.distribution("taxinet_ros").read_text("direct_url.json") or "{}"; \
  owner = pathlib.Path(json.loads(text).get("url", "").removeprefix("file://")); \
  sys.exit(owner.is_dir() and not owner.samefile(".") and str(owner))

own: $(DONE)/venv
	@owner=$$($(BIN)/python -c '$(OWNER)' 2>&1) || case "$$owner" in /*) \
	  echo "make: $(VENV) belongs to the checkout in $$owner; name another one: VENV=.venv-here" >&2; \
	  exit 2;; esac

$(DONE)/packages: $(DONE)/venv setup.py package.xml pyproject.toml $(CONSTRAINTS) hashes.txt \
  $(SHARED) $(NATIVE) | own
	@echo 'make: installing taxinet_ros and what it needs (minutes the first time)'
	@printf '$(MODERN)' | c++ -std=c++20 -fsyntax-only -x c++ - 2>/dev/null || { \
	  echo 'make: compiler "c++" knows no C++20; GCC 11, Clang 14 and newer do:' \
	    "$$(c++ --version | head -1)" >&2; \
	  exit 2; }
	@$(if $(HASHES),$(VERIFIED) hashes.txt,$(INSTALL) pybind11) || { \
	  echo 'make: not the files of hashes.txt; an index of other builds? without HASHES the' \
	    'versions in $(CONSTRAINTS) are enough' >&2; \
	  exit 2; }
	@$(CHOOSE_TORCH); $(BEAT); $(INSTALL) --no-build-isolation -e '.[ros]'
	@sed -n '/^opencv-python-headless==/,/[^\]$$/p' hashes.txt > $(DONE)/headless
	@$(BIN)/python -c '$(HEADLESS)' 2>/dev/null || \
	  $(if $(HASHES),$(VERIFIED) $(DONE)/headless --force-reinstall,\
	    $(INSTALL) --no-deps --force-reinstall opencv-python-headless)
	@touch $@

$(DONE)/messages: $(DONE)/packages $(INTERFACES)
	@echo 'make: building the messages (a minute when they changed)'
	@$(BIN)/python msg_defs/build_with_wheels.py
	@touch $@

$(DONE)/tools: setup.py $(CONSTRAINTS) | $(DONE)/packages
	@echo 'make: installing what tests and docs need, some 90 packages'
	@$(CHOOSE_TORCH); $(BEAT); $(INSTALL) --no-build-isolation -e '.[ros,test,dev,docs]'
	@touch $@

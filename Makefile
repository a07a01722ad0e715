# Set-up and the jobs: `make bit` runs the built-in test, `make test` the quick tests,
# `make test-slow` all others.
# Needs only Python 3.10 to 3.13 (with venv), make and a C compiler. Safe to run again, in any order.

PYTHON  ?= python3
VENV    ?= .venv
PROFILE ?= extended
EFFECT  ?= turn_short.fraction=0.1 turn_short.phase=b
BIT_OPTIONS ?=
TESTS   ?= test
PYTEST_OPTIONS ?=
WORKERS ?= 2

RUN_EXTRAS  := ros,export
TEST_EXTRAS := ros,export,dask,test

# A stamp is written last: an installation that was interrupted leaves none.
RUN_STAMP  := $(VENV)/.installed-run
TEST_STAMP := $(VENV)/.installed-test
UNFINISHED := $(VENV)/.installing

PYTEST := $(VENV)/bin/python -m pytest
RESULTS := build/test-results
PIP := $(VENV)/bin/python -m pip install -qq -c constraints.txt
EFFECT_OPTIONS := $(foreach effect,$(filter-out none,$(EFFECT)),--effect '$(effect)')

.PHONY: help bit test test-slow
.DELETE_ON_ERROR:

help:
	@echo 'make bit    run the built-in test: actuator, monitor and prognostics as three processes'
	@echo '            EFFECT="$(EFFECT)" is hidden in the actuator (EFFECT=none: nothing)'
	@echo '            PROFILE=$(PROFILE) (or step); BIT_OPTIONS= further options of `ema bit`'
	@echo 'make test   run the quick tests, those of real ROS processes last; TESTS=test/unit for some,'
	@echo '            WORKERS=$(WORKERS) at a time, PYTEST_OPTIONS= options of pytest'
	@echo 'make test-slow  run the tests that take long, with the same options'
	@echo 'The environment is $(VENV), made by $(PYTHON) (PYTHON= another); delete it to begin anew.'

bit: $(RUN_STAMP)
	@$(VENV)/bin/ema bit --profile '$(PROFILE)' $(EFFECT_OPTIONS) $(BIT_OPTIONS); \
	status=$$?; \
	case $$status in \
		0) echo 'make bit: done, the actuator is healthy (ema bit: 0)' ;; \
		1) echo 'make bit: done, a fault was found (ema bit: 1)' ;; \
		3) echo 'make bit: done, the verdict is unknown or incomplete (ema bit: 3)' ;; \
		4) echo 'make bit: no verdict, the test was refused or aborted (ema bit: 4)' >&2; exit 4 ;; \
		*) echo "make bit: failed (ema bit: $$status)" >&2; exit $$status ;; \
	esac

test: $(TEST_STAMP)
	$(call run_tests,quick,not slow)

test-slow: $(TEST_STAMP)
	$(call run_tests,slow,slow)

# Where tests with real ROS processes are, all of them (test_make.py looks): fewer files to read.
ROS_TESTS := $(if $(filter test,$(TESTS)),test/ros test/unit/ros $(wildcard test/test_*.py),$(TESTS))

# $(call run_tests,NAME,MARKER): tests with real ROS processes run one at a time, after all others.
# Status 5 of pytest: none of that kind among TESTS.
define run_tests
	@$(PYTEST) -m 'not ros and $(2)' -n $(WORKERS) --dist loadfile \
		--junitxml=$(RESULTS)/$(1).xml $(PYTEST_OPTIONS) $(TESTS); others=$$?; \
	$(PYTEST) -m 'ros and $(2)' --junitxml=$(RESULTS)/$(1)-ros.xml \
		$(PYTEST_OPTIONS) $(ROS_TESTS); ros=$$?; \
	case $$others,$$ros in \
		0,0|0,5|5,0) echo 'make: all selected tests passed' ;; \
		5,5) echo 'make: no $(1) test among TESTS=$(TESTS)' >&2; exit 1 ;; \
		*) echo 'make: tests failed' >&2; exit 1 ;; \
	esac
endef

# $(call install,EXTRAS): an environment whose last installation was cut short is made anew.
define install
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
		|| { echo 'make: $(PYTHON) is not Python 3.10 to 3.13; use make PYTHON=python3.11' >&2; exit 2; }
	@if [ -e $(UNFINISHED) ] || ! $(VENV)/bin/python -m pip --version >/dev/null 2>&1; then \
		$(PYTHON) -m venv --clear $(VENV); \
	fi
	@touch $(UNFINISHED)
	@echo 'make: installing ema_phm[$(1)] into $(VENV), about a minute the first time'
	@$(PIP) pip setuptools wheel
	@$(PIP) --no-build-isolation --config-settings editable_mode=compat -e '.[$(1)]'
	@$(VENV)/bin/python -m compileall -q $(wildcard ema_*)
	@$(VENV)/bin/python -c 'import ema_cli.main'
	@rm $(UNFINISHED)
	@touch $@
endef

$(RUN_STAMP): constraints.txt setup.py
	$(call install,$(RUN_EXTRAS))
	@rm -f $(VENV)/share/man/man1/ema*.1
	@$(VENV)/bin/ema man --quiet --out $(VENV)/share/man/man1 >/dev/null
	@echo 'make: compiling the simulator, about half a minute'
	@$(VENV)/bin/python -m ema_sim.node.server

$(TEST_STAMP): $(RUN_STAMP)
	$(call install,$(TEST_EXTRAS))

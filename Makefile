PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable

# The tests start processes, each of which would compile kbstore anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test pgbouncer test-browser test-ros test-ros1 test-ros2 lint bench

demo: .venv/runtime
	$(BIN)/python -m kbstore.cli.demo

test: .venv/dev pgbouncer
	$(BIN)/python -m pytest -n auto --dist worksteal

# PgBouncer comes from Debian's package, which root can install where it is not started as a service, too; where it is
# not there, a line says so.
HAS_PGBOUNCER := PATH="$$PATH:/usr/sbin" command -v pgbouncer >/dev/null

pgbouncer:
	@$(HAS_PGBOUNCER) || [ "$$(id -u)" != 0 ] || [ -d /run/systemd/system ] || ! command -v apt-get >/dev/null || \
	  { apt-get update -q && apt-get install -q -y --no-install-recommends pgbouncer; } >/dev/null || true
	@$(HAS_PGBOUNCER) || echo "Poolers are tested by a double alone: install pgbouncer."

# Chromium comes from the system's packages, which root can install; where it is not there, a line says so.
test-browser: .venv/browser
	@{ command -v chromium && command -v chromedriver; } >/dev/null || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null || \
	  { apt-get update -q && apt-get install -q -y --no-install-recommends chromium chromium-driver fonts-dejavu-core; }
	@if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then \
	  KBSTORE_TEST_BROWSER=1 $(BIN)/python -m pytest tests/timeline/test_browser.py tests/timeline/test_live.py; \
	else echo "The page of the timeline is not tested in a browser: install chromium and chromedriver."; fi

test-ros: test-ros2 test-ros1

# ROS 2 comes from the package index, for some versions of Python; where it cannot be installed, a line says why.
test-ros2:
	@log=$$(mktemp); if $(MAKE) --no-print-directory .venv-ros/messages >$$log 2>&1; then \
	  rm $$log; .venv-ros/bin/python -m pytest tests/ros/test_package.py tests/ros/test_plansys2_graph.py; \
	else echo "PlanSys2's nodes are not tested on a graph of ROS 2, which cannot be installed here:"; tail -n 3 $$log; rm $$log; fi

# ROS 1 comes from Debian's packages for Debian's own Python, which root can install; where it is not there, a line
# says so. Its client library leaves sockets open at the end.
ROS1_PACKAGES := python3-venv ros-core python3-rospy ros-std-msgs python3-std-msgs python3-std-srvs python3-genpy \
  python3-rosgraph-msgs ros-diagnostic-msgs python3-diagnostic-msgs
HAS_ROS1 := /usr/bin/python3 -c 'import ensurepip, genpy, rospy' 2>/dev/null

test-ros1:
	@$(HAS_ROS1) || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null || \
	  { apt-get update -q && apt-get install -q -y --no-install-recommends $(ROS1_PACKAGES); } || true
	@if $(HAS_ROS1); then $(MAKE) --no-print-directory .venv-ros1/ready && \
	  .venv-ros1/bin/python -m pytest -W "ignore:unclosed:ResourceWarning" tests/ros/test_rosplan_node.py; \
	else echo "ROSPlan's node is not tested on a graph of ROS 1: install $(ROS1_PACKAGES)."; fi

lint: .venv/dev
	$(BIN)/ruff check && $(BIN)/ruff format --check && $(BIN)/mypy

bench: .venv/bench
	$(BIN)/python -m benchmarks

# One environment, filled as far as a target needs it: kbstore's dependencies, the tools of the tests, the benchmarks'
# peers. A stamp says how far it is.
.venv/runtime: pyproject.toml
	@echo "Setting up .venv with kbstore and its dependencies (about 90 MB), once."
	@$(PYTHON) -m venv .venv
	@$(INSTALL) .
	@touch $@

.venv/dev: .venv/runtime
	@echo "Installing what the tests need into .venv (about 900 MB more), once."
	@$(INSTALL) '.[dev]'
	@touch $@

.venv/browser: .venv/dev
	@$(INSTALL) '.[dev,browser]'
	@touch $@

.venv/bench: .venv/dev
	@echo "Installing what the benchmarks compare with into .venv, once."
	@$(INSTALL) '.[dev,bench]'
	@touch $@

.venv-ros1/ready: pyproject.toml
	@/usr/bin/python3 -m venv --system-site-packages .venv-ros1
	@.venv-ros1/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[postgresql]' pytest pytest-timeout
	@touch $@

.venv-ros/ready: pyproject.toml
	@$(PYTHON) -m venv .venv-ros
	@.venv-ros/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[postgresql]' pytest pytest-timeout \
	  catkin-pkg colcon-ros 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-std-msgs
	@touch $@

# PlanSys2's messages, generated and compiled once (one to three minutes).
.venv-ros/messages: tests/ros/plansys2_build.py $(wildcard tests/ros/plansys2_msgs/*/*) | .venv-ros/ready
	@AMENT_PREFIX_PATH=$(CURDIR)/.venv-ros .venv-ros/bin/python tests/ros/plansys2_build.py
	@touch $@

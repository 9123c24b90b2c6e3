# Needs Python 3.11 or newer, pip and make; everything else is installed into .venv.
PYTHON ?= python3
BIN := .venv/bin
# pip is run from outside: a venv with a pip of its own needs ensurepip, which Debian packages apart.
INSTALL := $(PYTHON) -m pip --python $(BIN)/python install --quiet -c constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore
# One process a core. Each takes neighbouring tests, since what is compiled stays in its process, and the one that is done
# first takes over half of what the other has left.
PYTEST := $(BIN)/pytest -n 2 --dist worksteal

.PHONY: demo test usb-test viewer-test lint docs packages clean

demo: .venv/.installed-demo
	$(BIN)/hapjax demo

# The second run is the float32 half of the suite with 64-bit numbers off, as a user has them: see CONTRIBUTING.md.
test: .venv/.installed-dev
	$(PYTEST)
	JAX_ENABLE_X64=0 $(PYTEST)

# The Falcon's driver through libusb itself. umockdev's bindings are for the system's Python, so apt is asked for them.
UMOCKDEV := command -v umockdev-wrapper >/dev/null && \
	/usr/bin/python3 -c 'import gi; gi.require_version("UMockdev", "1.0")' 2>/dev/null
usb-test: .venv/.installed-dev
	@{ $(UMOCKDEV); } || { [ "$$(id -u)" = 0 ] && apt-get -qq update && \
		apt-get -qq install -y umockdev gir1.2-umockdev-1.0 python3-gi libusb-1.0-0; } >/dev/null 2>&1 || true
	@if $(UMOCKDEV); then \
		umockdev-wrapper /usr/bin/python3 tests/usb_bridge.py $(BIN)/python -m pytest tests/devices/test_falcon_usb.py; \
	else \
		echo "usb-test is skipped: it needs the packages umockdev, gir1.2-umockdev-1.0 and python3-gi"; \
	fi

# The viewer's page in a real browser; what it looks like is kept in .pytest_cache/viewer.
viewer-test: .venv/.installed-dev
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && apt-get -qq update && \
		apt-get -qq install -y chromium; } >/dev/null 2>&1 || true
	@if command -v chromium >/dev/null; then \
		HAPJAX_CHROMIUM=$$(command -v chromium) $(BIN)/pytest tests/devices/test_viewer_page.py; \
	else \
		echo "viewer-test is skipped: it needs chromium"; \
	fi

lint: .venv/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

docs: .venv/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Sdist and wheel, and the wheel in an empty environment with each extra alone.
packages:
	PYTHON=$(PYTHON) .ci/packages

clean:
	rm -rf .venv .cache site dist build hapjax-demo .pytest_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed-demo: EXTRAS := fitting,devices
.venv/.installed-dev: EXTRAS := fitting,devices,falcon,inverse3,posterior,recording,viewer,bench,dev
.venv/.installed-docs: EXTRAS := docs,fitting

.venv/.installed-%: pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing hapjax with [$(EXTRAS)] into .venv ..."
	$(INSTALL) -e '.[$(EXTRAS)]'
	@touch $@

$(BIN)/python:
	$(PYTHON) -m venv --without-pip .venv

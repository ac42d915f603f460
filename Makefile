# Nothing here needs more than Rust and a C compiler; scripts/setup.sh sees to the rest.
.PHONY: help demo test lint clean-demo
.DEFAULT_GOAL := help

# A fresh rustup is not yet on the PATH of the shell that installed it.
export PATH := $(PATH):$(HOME)/.cargo/bin
# NAME counts when it is said to make, not when the machine happens to have one (WSL does).
ifeq ($(origin NAME),environment)
NAME :=
endif
export DEM NAME PORT ARGS HEADLESS

help: ## List the targets
	@echo 'make demo         build all, make a terrain, serve it, and fly through it in a window;'
	@echo '                  without a display: write pictures and a summary into demo/'
	@echo '    DEM=FILE...       take these DEM files instead; several make one mosaic'
	@echo '    ARGS="..."        more for "escarp-tiles build", as --spacing 160 --height-step 0.1'
	@echo '    NAME=NAME         name of the dataset; default: that of the first file'
	@echo '    PORT=N            port of the server; default: a free one'
	@echo '    HEADLESS=1        write pictures even where there is a display'
	@echo 'make test         install what is missing, run all tests (with CI set: lint first)'
	@echo 'make lint         check the code only: rustfmt, clippy, cargo-deny where installed'
	@echo 'make clean-demo   remove the folder demo/'

demo: ## See a terrain
	@scripts/demo.sh

test: ## Run all tests
	@scripts/test.sh

lint: ## Check the code
	@scripts/lint.sh

clean-demo: ## Remove what the demo made
	rm -rf demo

# make tables   the whole chain on the virtual rig: Tables 8 and 9 beside the published ones
# make corrected  known loads learned, Table 8 three times: published, without and with correction
# make real-data DATA=folder of mis-tool  a real instrument: torque from current against a sensor
# make test     style, types and tests
# make docs     the documentation as a site, in build/docs
# make fixtures store the fixtures anew; make bench measures speed; make clean removes results

PYTHON ?= python3
RECIPE ?= recipes/briaire-2006.toml
BUILD ?= build
SET ?=
RIGTOOL := .venv/bin/rigtool
INSTALLED := .venv/installed
MEASURE = --overwrite $(foreach value,$(SET),--set $(value))
PULLEY = --set rig.attachment=pulley

RUNS := $(addprefix $(BUILD)/,kt.h5 friction.h5 ripple.h5 \
	tables-pulley.h5 tables-instrument.h5 force-pulley.h5 force-instrument.h5)

.PHONY: real-data tables corrected test docs fixtures bench clean
.DELETE_ON_ERROR:

tables: $(BUILD)/report/index.html
	@cat $(BUILD)/report/tables.txt

corrected: $(BUILD)/corrected/index.html
	@cat $(BUILD)/corrected/tables.txt

$(INSTALLED): requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	.venv/bin/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation --editable .
	touch $@

$(BUILD):
	mkdir -p $@

$(BUILD)/kt.h5: $(RECIPE) | $(INSTALLED) $(BUILD)
	$(RIGTOOL) calibrate-kt $< -o $@ $(MEASURE)

$(BUILD)/friction.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) stribeck $< --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/ripple.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) fft-ripple $< --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/tables-instrument.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $< --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/tables-pulley.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $< --kt $(BUILD)/kt.h5 $(PULLEY) -o $@ $(MEASURE)

$(BUILD)/force-instrument.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-instrument.h5
	$(RIGTOOL) measure-force $< --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-instrument.h5 \
		-o $@ $(MEASURE)

$(BUILD)/force-pulley.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-pulley.h5
	$(RIGTOOL) measure-force $< --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-pulley.h5 \
		$(PULLEY) -o $@ $(MEASURE)

$(BUILD)/tables-loads.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $< --kt $(BUILD)/kt.h5 --implementation D -o $@ $(MEASURE)

$(BUILD)/force-corrected.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-loads.h5
	$(RIGTOOL) measure-force $< --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-loads.h5 \
		--correction full -o $@ $(MEASURE)

$(BUILD)/corrected/index.html: $(addprefix $(BUILD)/,kt.h5 tables-loads.h5 force-corrected.h5)
	$(RIGTOOL) report $^ -o $(BUILD)/corrected --overwrite -q

$(BUILD)/report/index.html: $(RUNS)
	$(RIGTOOL) report $(RUNS) -o $(BUILD)/report --overwrite -q

DATA ?= ../shared/data/mis-tool
TOOL ?= Tool_4_Maryland_L_4

real-data: | $(INSTALLED) $(BUILD)
	@test -d "$(DATA)/$(TOOL)" || { echo "$(DATA)/$(TOOL) is not there: say DATA=, the folder of the" \
		"measured instruments, and TOOL= where it is another one (docs/real-instruments.md)" >&2; exit 2; }
	rm -rf $(BUILD)/$(TOOL)
	$(RIGTOOL) import $(DATA)/$(TOOL) --map recipes/import/mis-tool.toml -o $(BUILD)/$(TOOL) -q
	$(RIGTOOL) ilc-learn $(BUILD)/$(TOOL)/?[02468].h5 --implementation D \
		-o $(BUILD)/$(TOOL)-tables.h5 --overwrite
	$(RIGTOOL) measure-force $(BUILD)/$(TOOL)/?[13579].h5 --tables $(BUILD)/$(TOOL)-tables.h5 \
		-o $(BUILD)/$(TOOL)-force.h5 --overwrite
	$(RIGTOOL) report $(BUILD)/$(TOOL)-force.h5 -o $(BUILD)/$(TOOL)-report --overwrite

test: $(INSTALLED)
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/pytest

docs: $(INSTALLED)
	.venv/bin/python -m sphinx -b html -W --keep-going -n -q docs $(BUILD)/docs

fixtures: $(INSTALLED)
	.venv/bin/python tests/fixtures/make.py

bench: $(INSTALLED)
	.venv/bin/python benchmarks/bench.py

clean:
	rm -rf $(BUILD)

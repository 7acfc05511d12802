# make tables         the whole chain on the virtual rig: Tables 8 and 9 beside the published ones
# make corrected      known loads learned, Table 8 three times: published, without and with correction
# make over-time      an unknown force in strokes, free motion and against tissue, as figures
# make thesis         every figure and table of the thesis beside the virtual rig, in build/thesis,
#                     and its numbers against those of docs/reproduction
# make pages          docs/reproduction from what make thesis made
# make real-data      a real instrument: torque from current against a sensor; DATA=folder of mis-tool
# make test           style, types and tests
# make test-lowest    the tests with the lowest versions of pyproject.toml
# make attack         kills, signals, damaged files, changed recipes, properties; SECONDS=600 SEED=20061
# make docs           the documentation as a site, in build/docs
# make bench          speed and memory of what users wait for
# make accuracy       force over time and contacts against what acted, on virtual rigs that are learned
# make coverage       whether stated intervals hold, on virtual rigs drawn anew
# make coverage-short five minutes of it, with an exit code
# make fixtures       the runs in tests/fixtures, stored anew
# make references     what the tests compare outcomes with, analysed anew
# make release-check  tests, site, source distribution, wheel: what a release needs
# make clean          removes build
# make help           shows this list
# Settings: RECIPE=file, BUILD=folder, SET="table.key=value ..."; other settings remake what they change

PYTHON ?= python3
RECIPE ?= recipes/briaire-2006.toml
BUILD ?= build
SET ?=
SECONDS ?= 600
SEED ?= 20061
BIN := .venv/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
LOWEST := .venv-lowest/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
RIGTOOL := $(BIN)/rigtool
INSTALLED := .venv/installed
MEASURE = --overwrite $(foreach value,$(SET),--set $(value))
PULLEY = --set rig.attachment=pulley

RUNS := $(addprefix $(BUILD)/,kt.h5 friction.h5 ripple.h5 \
	tables-pulley.h5 tables-instrument.h5 force-pulley.h5 force-instrument.h5)

# Without byte code on disk every command compiles its modules anew: a start takes twice as long.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: pages real-data tables corrected over-time thesis test test-lowest docs fixtures references bench accuracy coverage coverage-short attack release-check clean help
.DELETE_ON_ERROR:

# The longest chains first: with two jobs both cores have work until the report.
tables: $(addprefix $(BUILD)/,force-instrument.h5 force-pulley.h5 report/index.html)
	@cat $(BUILD)/report/tables.txt

corrected: $(BUILD)/corrected/index.html
	@cat $(BUILD)/corrected/tables.txt

$(INSTALLED): requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation --editable .
	touch $@

$(BUILD):
	mkdir -p $@

# A change of RECIPE or SET remakes the runs of the commands that it concerns: a setting of a
# command's own table concerns that command, any other all of them.
SECTIONS := calibrate_kt stribeck fft_ripple identify_plant ilc_learn measure_force suspension
settings_of = $(RECIPE) $(filter-out $(addsuffix .%,$(filter-out $(1),$(SECTIONS))),$(SET))
STAMPS := $(addprefix $(BUILD)/settings-,$(SECTIONS))

$(STAMPS): $(BUILD)/settings-%: FORCE | $(BUILD)
	@$(if $(subst |$(file <$@)|,,|$(call settings_of,$*)|),$(file >$@,$(call settings_of,$*)))

FORCE:

$(BUILD)/kt.h5: $(BUILD)/settings-calibrate_kt
$(BUILD)/friction.h5 $(BUILD)/thesis/idm640.h5: $(BUILD)/settings-stribeck
$(BUILD)/ripple.h5: $(BUILD)/settings-fft_ripple
$(addprefix $(BUILD)/,tables-instrument.h5 tables-pulley.h5 tables-loads.h5): $(BUILD)/settings-ilc_learn
$(addprefix $(BUILD)/thesis/,a.h5 b.h5): $(BUILD)/settings-ilc_learn
$(BUILD)/thesis/plant.h5: $(BUILD)/settings-identify_plant
$(BUILD)/thesis/suspension.h5: $(BUILD)/settings-suspension
$(addprefix $(BUILD)/,force-instrument.h5 force-pulley.h5 force-corrected.h5): $(BUILD)/settings-measure_force
$(addprefix $(BUILD)/over-time/,strokes.h5 free-motion.h5 tissue.h5): $(BUILD)/settings-measure_force

$(BUILD)/kt.h5: $(RECIPE) | $(INSTALLED) $(BUILD)
	$(RIGTOOL) calibrate-kt $(RECIPE) -o $@ $(MEASURE)

$(BUILD)/friction.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) stribeck $(RECIPE) --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/ripple.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) fft-ripple $(RECIPE) --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/tables-instrument.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $(RECIPE) --kt $(BUILD)/kt.h5 -o $@ $(MEASURE)

$(BUILD)/tables-pulley.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $(RECIPE) --kt $(BUILD)/kt.h5 $(PULLEY) -o $@ $(MEASURE)

$(BUILD)/force-instrument.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-instrument.h5
	$(RIGTOOL) measure-force $(RECIPE) --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-instrument.h5 \
		-o $@ $(MEASURE)

$(BUILD)/force-pulley.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-pulley.h5
	$(RIGTOOL) measure-force $(RECIPE) --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-pulley.h5 \
		$(PULLEY) -o $@ $(MEASURE)

$(BUILD)/tables-loads.h5: $(RECIPE) $(BUILD)/kt.h5
	$(RIGTOOL) ilc-learn $(RECIPE) --kt $(BUILD)/kt.h5 --implementation D -o $@ $(MEASURE)

$(BUILD)/force-corrected.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/tables-loads.h5
	$(RIGTOOL) measure-force $(RECIPE) --kt $(BUILD)/kt.h5 --tables $(BUILD)/tables-loads.h5 \
		--correction full -o $@ $(MEASURE)

$(BUILD)/corrected/index.html: $(addprefix $(BUILD)/,kt.h5 tables-loads.h5 force-corrected.h5)
	$(RIGTOOL) report $^ -o $(BUILD)/corrected --overwrite -q

$(BUILD)/report/index.html: $(RUNS)
	$(RIGTOOL) report $(RUNS) -o $(BUILD)/report --overwrite -q

# Contacts of the virtual rig, unknown to the program; the recorded reference_torque judges.
OVER_TIME := $(BUILD)/over-time
PULSES = 'virtual.contact=[{kind="pulse",rate_per_min=20,duration=[0.3,2.0],force=[0.1,2.5]}]'
TISSUE = 'virtual.contact=[{kind="tissue",at=[0],angle_deg=100,stiffness=0.03,damping=1e-3}]'
OVER_TIME_RUNS := $(addprefix $(OVER_TIME)/,strokes.h5 free-motion.h5 tissue.h5)
MEASURE_OVER_TIME = $(RIGTOOL) measure-force $(RECIPE) --kt $(BUILD)/kt.h5 \
	--tables $(BUILD)/tables-loads.h5 -o $@ $(MEASURE)

over-time: $(OVER_TIME)/report/index.html

$(OVER_TIME): | $(BUILD)
	mkdir -p $@

$(OVER_TIME)/strokes.h5: $(BUILD)/tables-loads.h5 | $(OVER_TIME)
	$(MEASURE_OVER_TIME) --record 20 --set $(PULSES)

$(OVER_TIME)/free-motion.h5: $(BUILD)/tables-loads.h5 | $(OVER_TIME)
	$(MEASURE_OVER_TIME) --observe 20 --set $(PULSES)

$(OVER_TIME)/tissue.h5: $(BUILD)/tables-loads.h5 | $(OVER_TIME)
	$(MEASURE_OVER_TIME) --record 20 --set $(TISSUE)

$(OVER_TIME)/report/index.html: $(OVER_TIME_RUNS)
	$(RIGTOOL) report $^ -o $(OVER_TIME)/report --overwrite -q

THESIS := $(BUILD)/thesis
THESIS_RUNS := $(RUNS) $(addprefix $(THESIS)/,plant.h5 a.h5 b.h5 suspension.h5 idm640.h5)

thesis: $(THESIS_RUNS)
	$(BIN)/python -m thesis.reproduction $^ --to $(THESIS) --html $(THESIS)/reproduction.html \
		--against docs

pages: $(THESIS_RUNS)
	$(BIN)/python -m thesis.reproduction $^ --to docs --html $(THESIS)/reproduction.html

$(THESIS): | $(BUILD)
	mkdir -p $@

$(THESIS)/plant.h5: $(RECIPE) $(BUILD)/kt.h5 | $(THESIS)
	$(RIGTOOL) identify-plant $(RECIPE) --kt $(BUILD)/kt.h5 $(PULLEY) -o $@ $(MEASURE)

$(THESIS)/a.h5: $(RECIPE) $(BUILD)/kt.h5 $(BUILD)/friction.h5 | $(THESIS)
	$(RIGTOOL) ilc-learn $(RECIPE) --kt $(BUILD)/kt.h5 --friction $(BUILD)/friction.h5 \
		$(PULLEY) --implementation A --validate -o $@ $(MEASURE)

$(THESIS)/b.h5: $(RECIPE) $(BUILD)/kt.h5 | $(THESIS)
	$(RIGTOOL) ilc-learn $(RECIPE) --kt $(BUILD)/kt.h5 $(PULLEY) --implementation B --validate \
		-o $@ $(MEASURE)

$(THESIS)/suspension.h5: $(RECIPE) | $(INSTALLED) $(THESIS)
	$(RIGTOOL) suspension $(RECIPE) -o $@ $(MEASURE)

# A faulty amplifier [App. C]: exit code 4 is the result, what was recorded until then is kept.
FAULTY = --set virtual.amplifier.distortion=0.05 --set virtual.amplifier.distortion_period=0.06

$(THESIS)/idm640.h5: $(RECIPE) $(BUILD)/kt.h5 | $(THESIS)
	rm -f $@ $@.part
	@echo "Expected: stribeck refuses the data of this faulty amplifier, exit code 4; recover keeps them"
	$(RIGTOOL) stribeck $(RECIPE) --kt $(BUILD)/kt.h5 $(FAULTY) -o $@ $(MEASURE); test $$? -eq 4
	$(RIGTOOL) recover $@.part -o $@ && rm $@.part

DATA ?= ../shared/data/mis-tool
TOOL ?= Tool_4_Maryland_L_4

real-data: | $(INSTALLED) $(BUILD)
	@test -d "$(DATA)/$(TOOL)" || { echo "$(DATA)/$(TOOL) is not there: say DATA=, the folder of the" \
		"measured instruments, and TOOL= where it is another one (docs/real-instruments.md)" >&2; exit 2; }
	rm -rf $(BUILD)/$(TOOL)
	$(RIGTOOL) import $(DATA)/$(TOOL) --map recipes/import/mis-tool.toml -o $(BUILD)/$(TOOL) -q
	for hz in 5 50; do \
		$(RIGTOOL) ilc-learn $(BUILD)/$(TOOL)/?[02468].h5 --implementation D \
			--set measure_force.lowpass_hz=$$hz -o $(BUILD)/$(TOOL)-tables-$$hz.h5 --overwrite && \
		$(RIGTOOL) measure-force $(BUILD)/$(TOOL)/?[13579].h5 --tables $(BUILD)/$(TOOL)-tables-$$hz.h5 \
			-o $(BUILD)/$(TOOL)-force-$$hz.h5 --overwrite || exit; \
	done
	$(RIGTOOL) report $(BUILD)/$(TOOL)-force-5.h5 $(BUILD)/$(TOOL)-force-50.h5 \
		-o $(BUILD)/$(TOOL)-report --overwrite

# All workers then find machine code, which one process makes, and the byte code of all tests, which
# another one makes after the types.
test: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	($(BIN)/mypy; types=$$?; $(BIN)/pytest -q --collect-only >/dev/null; exit $$types) & \
		$(BIN)/pytest -q -m compiles $$(grep -rl --include=*.py mark.compiles tests); \
		tests=$$?; wait $$! && exit $$tests
	$(BIN)/pytest -n 3 --dist worksteal -m "not compiles and not thorough"

test-lowest:
	$(PYTHON) -m venv .venv-lowest
	$(PYTHON) tests/lowest.py > .venv-lowest/lowest.txt
	$(LOWEST)/python -m pip install --quiet --constraint .venv-lowest/lowest.txt \
		'setuptools>=77' --editable '.[test]'
	$(LOWEST)/pytest -n 2 --dist worksteal -W default -m "not real_time and not thorough" \
		--deselect tests/test_package.py::test_the_locked_versions_install_with_the_lowest_python

attack: $(INSTALLED)
	$(BIN)/python -m tests.attack --seconds $(SECONDS) --seed $(SEED)
	$(BIN)/pytest -n 3 --dist worksteal -m "hypothesis or thorough" --hypothesis-profile luck

docs: $(INSTALLED)
	$(BIN)/python -m sphinx -b html -W --keep-going -n -q docs $(BUILD)/docs

fixtures: $(INSTALLED)
	$(BIN)/python -m tests.fixtures.make

references: $(INSTALLED)
	$(BIN)/python -m tests.fixtures.make --analyse
	rm -f tests/fixtures/outcomes.json
	STORE_OUTCOMES=1 $(BIN)/python -m pytest -q -n 0 $$(grep -rl --include=test_*.py require_unchanged tests)

bench: $(INSTALLED)
	$(BIN)/python benchmarks/bench.py

accuracy: $(INSTALLED)
	$(BIN)/python benchmarks/learned.py --tables $(BUILD)/learned
	$(BIN)/python benchmarks/contacts.py --tables $(BUILD)/learned

coverage: $(INSTALLED)
	$(BIN)/python benchmarks/coverage.py

coverage-short: $(INSTALLED)
	$(BIN)/python benchmarks/coverage.py --short

release-check: test docs
	$(BIN)/python release_check.py

clean:
	rm -rf $(BUILD)

help:
	@sed -n '/^#/!q; s/^# //p' Makefile

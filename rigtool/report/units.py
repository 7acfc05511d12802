"""Units of the columns that figures and tables of loads show: a label holds for these alone.

Runs of `import` may have their effort in other units, and a table may have been edited.
"""

from __future__ import annotations

from rigtool.runfile import Run

_NAMES = {
    "N": "applied_force",
    "N m": """amplitude applied applied_torque before error_torque falling lifting
        loaded_negative loaded_positive lowering mean_torque mean_torque_u negative noise_floor
        non_repeatable_rms off off_peak off_rms on on_peak on_rms peak plain positive residual
        residual_peak residual_rms rising rms std_torque table torque value""",
    "rad/s": "speed low_speed",
    "rad": "phase position shift l_phase s_phase sp_phase t_phase open_loop_phase",
    "rad/(N m)": "magnitude mass_line radius sp_magnitude",
    "A": "current current_setpoint",
    "N m/A": "torque_constant",
    "Hz": "frequency",
    "degC": "temperature",
    "s": "time",
    "%": "error_percent",
}
UNITS = {name: unit for unit, names in _NAMES.items() for name in names.split()}
"""Unit of a column by its name."""

OTHERS = {
    ("amplitude", "amplitude"): "1",
    ("tuning", "amplitude"): "1",
    ("convergence", "magnitude"): "1",
    **{
        (table, "position"): "count"
        for table in ("cycles_no_load", "mean_cycles", "feedforward", "hysteresis", "shift")
    },
}
"""Units of the columns of single tables."""


def other_unit(run: Run, *tables: str) -> str | None:
    """Return what is not in the unit that a report shows, None where everything is."""
    for name in tables:
        for column, stored in run.tables[name].columns.items():
            unit = OTHERS.get((name, column), UNITS.get(column, stored.unit))
            if stored.unit != unit:
                return f"column {column} of table {name} is in {stored.unit!r}, not in {unit!r}"
    return None

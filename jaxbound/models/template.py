"""A commented model file, which loads as it is: what a user begins with."""


def template() -> str:
    """Return a commented model file that loads as it is: a starting point for one's own.

    Example:
        >>> print(template().splitlines()[0])
        # jaxbound model file (TOML). Delete what you do not need; every number is taken exactly as written.
    """
    return TEMPLATE


TEMPLATE = """\
# jaxbound model file (TOML). Delete what you do not need; every number is taken exactly as written.
# Check it with:  jaxbound info MODEL.toml          Use it with:  jaxbound detect MODEL.toml DATA.csv --out REPORT

name = "tank"
dt = 1.0             # sampling period of model and recording, in seconds
# horizon = 15       # windows have 16 samples unless --test says otherwise: those for which the bounds were found
# lags = [0, 1, 2, 4, 8, 16]   # in place of horizon: look at the outputs only so many samples before the last of a window
# time = "Time"      # column of the time stamps; without it, a column that looks like time is taken
# where = "Fan > 0"  # samples for which this does not hold are no part of the recording: windows with them are MISSING
# constant_tolerance = true   # theta below keeps one value over a window (a gain error), instead of being drawn anew each sample
states = ["level", "flow"]

# x+ = A x + B u + G w + F v,   y = C x + D u + D_v v.   One row per state (A, B, G, F) or output (C, D, D_v).
# Numbers, or fractions in quotes: "1/3". Leave B and [[inputs]] out if nothing drives the plant, D if it is zero, G and [[disturbances]]
# if nothing else acts on it. F and D_v, left out here, are for inputs v of which nothing is known, not even a bound.
[matrices]
A = [
    [0.98, 0.05],
    [0.0, 0.9],
]
B = [
    [0.0],
    [0.1],
]
C = [
    [1.0, 0.0],
    [0.0, 1.0],
]
G = [
    [-1.0],
    [0.0],
]

# One [[inputs]] block per column of B, in order.
[[inputs]]
name = "pump"
unit = "%"           # optional, for the report
column = "Pump [%]"  # optional: the column of the recording, if it is not called like the signal, or "= `In (bar)` - `Out (bar)`"
offset = 50          # optional: operating point; the model speaks of (recorded value - offset)
range = [30, 70]     # optional: between which it moves; verdicts say what lies outside, and jaxbound study draws its levels there

# One [[outputs]] block per row of C, in order, with what is known of its sensor:
#     recorded = (1 + theta) (true value) + e,    |theta| <= tolerance,   |e| <= noise + resolution,   drawn anew each sample
[[outputs]]
name = "level"
unit = "m"
tolerance = 0.01     # relative: 1 % of the value (of the deviation from the offset)
noise = 0.02         # absolute, in the unit of the output
resolution = 0.0005  # half a step of what the recorder rounds to: three decimals

[[outputs]]
name = "flow"
unit = "m3/s"
noise = 0.05         # or a bound that follows the operating point: noise = {bound = 0.05, times = "1 + abs(pump - 50) / 100"}
# averages = [{samples = 16, bound = 0.01}]   # errors that average out: so large at most is the mean of 16 consecutive ones

# One [[disturbances]] block per column of G, in order: what acts on the states unmeasured, drawn anew each sample within its bound.
[[disturbances]]
bound = [0, 0.001]   # lowest and highest, here a leak; one number, bound = 0.001, means |w| <= 0.001

# One [[uncertainty]] block per parameter that is not known exactly, with what it multiplies: A(v) = A + v dA, the same for B, C, D.
# varying = true: another value at each sample; false: one value over a window. [matrices] holds the values at v = 0.
# [[uncertainty]]
# name = "valve"
# between = [-1, 1]
# varying = true
# B = [
#     [0.0],
#     [0.02],
# ]

# Where the bounds come from, for the report: a proof is as good as its bounds.
[provenance]
model = "assumed"
tolerance = "datasheet"
noise = "datasheet"
resolution = "assumed"
disturbance = "assumed"

# One [[test]] block per test of a monitor; a fault is proved where one of them proves it. jaxbound detect then judges by all of them.
# [[test]]
# name = "jumps"       # windows of the model
# [[test]]
# name = "drifts"
# observer = "joint"   # or lags = [0, 1, 2, 4, 8, 16], or horizon = 60
# factor = 1.5         # on all bounds
# when = "pump > 40"   # optional: the test watches where this holds; "otherwise": where no other condition does

# How files are written, where looking at them does not say it; --recording says another one.
# [recording]
# missing = ["Bad", -999]     # words and numbers for missing samples
# time_format = "%d/%m/%Y"    # the day comes before the month
# zone = "Europe/Berlin"      # of time stamps that name none

# The rule by which FAULT makes alarms, for every command that makes some; --alarm says another one.
# [alarms]
# rule = "3/5"         # 3 FAULT among 5 windows
# merge = "10min"      # alarms of one suspect so far apart are one
# least = 0.5          # an output's smaller errors make none; or {level = 0.1, flow = 0.5}
# suspects = true      # name the signals that alone could be wrong
# latch = true         # an alarm stays on until a repair shows, or until it is acknowledged
# acknowledged = "seen.txt"   # beside this file: a time a line at which an operator acknowledged
"""

"""Hostile numbers and texts of problem files: at the edges of floats, nearly equal, letters that look alike, types that are mixed."""

# One case a line, of whatever length: a table.
# ruff: noqa: E501
# fmt: off

from tests.bench.hostile import Case
from tests.bench.hostile_files import REACH, problem

ANY = (0, 1, 2)
START, GOAL = "O = -49.07", "O = 56.27"


def reach(name: str, *changes: tuple[str, str], extra: str = "", codes: tuple[int, ...] = ANY, words: tuple[str, ...] = (), **more) -> Case:
    """Return a case of the knee's reach with texts replaced, each of which must be in it, and something added at its end."""
    text = REACH
    for old, new in changes:
        old, new = (f"duration_s = {word}" if old == "0.16" else word for word in (old, new))
        if old not in text:
            raise ValueError(f"{old!r} is not in the problem")
        text = text.replace(old, new)
    return problem(name, text + extra, *words, codes=codes, **more)


def via(*points: str) -> str:
    return "".join(f"\n[[motion.waypoints]]\n{point}\n" for point in points)


def batch(name: str, text: str, codes: tuple[int, ...] = ANY) -> Case:
    short = 'set = ["mesh.intervals=10", "solver.max_time_s=5"]\n'
    return problem(f"of a batch {name}", f'problem = "knee-reach"\n{short}{text}', "batch", "p.toml", "-o", "out", codes=codes)


FEW = ("--set", "mesh.intervals=10")
# A greater time than the knee needs, for what waits.
LONG = ("0.16", "0.5")
NUMBERS = (
    *(reach(f"of a duration of {text} s", ("0.16", text), codes=codes) for text, codes in (("1e-9", (1, 2)), ("5e-324", (1, 2)), ("1e-300", (1, 2)), ("1e308", (2,)), ("1e3", ANY), ("-0.0", (2,)), ("0", (2,)), ("1", (0,)), ("9223372036854775808", (2,)), ("0.16000000000000003", (0,)))),
    *(reach(f"of a goal at {text} deg", (GOAL, f"O = {text}"), codes=codes) for text, codes in (("-49.07", ANY), ("-49.07000000000001", ANY), ("-49.0700001", ANY), ("-0.0", (0, 1)), ("5e-324", (0, 1)), ("1e308", (2,)), ("90.0", ANY), ("90.00000000000001", ANY), ("360", (1, 2)), ("36e9", (1, 2)))),
    reach("of no way and a free time", (GOAL, START), ("0.16", '"free"'), ('minimize = "effort"', 'minimize = "time"')), reach("of a way of 1e-12 deg in least time", (GOAL, "O = -49.069999999999"), ("0.16", '"free"'), ('minimize = "effort"', 'minimize = "time"')), reach("of start and goal by all joints, a hair off", (START, "O = -49.07, A = 68.05585941588739")), reach("of dependent joints alone", (START, "C = 7.8"), (GOAL, "C = 20.0")),
    *(reach(f"via {name}", LONG, extra=via(*points), codes=codes) for name, points, codes in (
        ("two points within 1e-12 s", ("at_deg = { O = 0.0 }\ntime_s = 0.25", "at_deg = { O = 1e-9 }\ntime_s = 0.250000000001"), ANY), ("two points at one time", ("at_deg = { O = 0.0 }\ntime_s = 0.25", "at_deg = { O = 1.0 }\ntime_s = 0.25"), (1, 2)), ("two points at one place", ("at_deg = { O = 0.0 }\ntime_s = 0.2", "at_deg = { O = 0.0 }\ntime_s = 0.3"), ANY), ("the start", ("at_deg = { O = -49.07 }\ntime_s = 0.0",), ANY), ("the goal", ("at_deg = { O = 56.27 }\ntime_s = 0.5",), ANY), ("a time after the end", ("at_deg = { O = 0.0 }\ntime_s = 0.50000000000001",), ANY), ("a time of 1e-300", ("at_deg = { O = 0.0 }\ntime_s = 1e-300",), (1, 2)), ("a time before all", ("at_deg = { O = 0.0 }\ntime_s = -1e-12",), (2,)), ("points in reverse", ("at_deg = { O = 10.0 }\ntime_s = 0.3", "at_deg = { O = 0.0 }\ntime_s = 0.2"), ANY), ("a point that says nothing", ("",), (2,)), ("a point of infinity", ("at_deg = { O = inf }",), (2,)), ("20 points on the way", tuple(f"at_deg = {{ O = {-40 + 4 * k} }}" for k in range(20)), ANY))),
    *(reach(f"with limits {text}", extra=f"\n[limits]\n{text}\n", codes=codes) for text, codes in (
        ("effort = { act_O = [0.0, 0.0] }", (1, 2)), ("effort = { act_O = [-0.0, 5e-324] }", (1, 2)), ("effort = { act_O = [-1e308, 1e308] }", ANY), ("effort = { act_O = [99.9, 100.0] }", (1, 2)), ("effort = { act_O = 86.324 }", ANY), ("speed_deg_s = { O = 5e-324 }", (1, 2)), ("speed_deg_s = { O = 1e308 }", ANY), ("power_w = { act_O = 1e-300 }", (1, 2)), ("reserve = 0.9999999999999999", ANY), ("reserve = -0.0", ANY), ("closure_force = { B = 5e-324 }", (1, 2)))),
    *(reach(f"with {section}.{key} = {text}", extra=f"\n[{section}]\n{key} = {text}\n", words=("plan", "p.toml"), codes=ANY) for section, key, text in (
        ("mesh", "intervals", "1"), ("mesh", "intervals", "2"), ("mesh", "breaks", "[0.0, 0.5, 0.5000000000000001, 1.0]"), ("mesh", "breaks", "[0.0, 1.0]"), ("mesh", "breaks", "[-0.0, 1e-300, 1.0]"), ("solver", "starts", "1e308"), ("solver", "max_time_s", "1e-9"), ("solver", "max_time_s", "1e308"), ("solver", "starts", "-9223372036854775808"), ("robust", "payload_factor", "[1.0, 1.0]"), ("robust", "payload_factor", "[1.0, 1.0000000000000002]"))),
    *(reach(f"tracked with {text}", ("kp = 200.0\nkd = 20.0", text), words=("track", "p.toml", *FEW), codes=ANY) for text in ("kp = 5e-324\nkd = 5e-324", "kp = 1e308\nkd = 1e308", "kp = -0.0\nkd = 0.0", "kp = 200.0\nkd = 20.0\nperiod_s = 1e-9", "kp = 200.0\nkd = 20.0\nperiod_s = 0.16", "kp = 200.0\nkd = 20.0\nduration_s = 5e-324", "kp = 200.0\nkd = 20.0\nperiod_s = 0.00010000000000000002")),
    *(problem(f"of a sine with {old} = {new}", "", "plan", "knee-sine", "--set", f"{old}={new}", "--set", "mesh.intervals=10", "--set", "solver.max_time_s=5", codes=ANY) for old, new in (("motion.duration_s", "1e-9"), ("motion.duration_s", "5e-324"), ("reference.frequency_hz", "5e-324"), ("reference.frequency_hz", "1e308"), ("reference.amplitude_deg.O", "-0.0"), ("reference.amplitude_deg.O", "5e-324"))),
)
LOOKS = (
    reach("whose key has a Cyrillic o", ("duration_s", "durati\u043en_s"), codes=(2,)), reach("whose table has a Cyrillic o", ("[motion]", '["m\u043etion"]'), codes=(2,)), reach("whose joint is a Greek O", (START, '"\u039f" = -49.07'), codes=(2,)), reach("whose joint is full width", (START, '"\uff2f" = -49.07'), codes=(2,)), reach("whose joint has a mark after it", (START, '"O\u0301" = -49.07'), codes=(2,)), reach("whose joint has a space after it", (START, '"O " = -49.07'), codes=(2,)), reach("whose kind has a space of no width", ('"reach"', '"rea\u200bch"'), codes=(2,)), reach("whose word is in capitals", ('"effort"', '"EFFORT"'), codes=(2,)), reach("whose digits are Arabic", ("0.16", '"\u0660.\u0661\u0666"'), codes=(2,)), reach("whose minus is a dash", (START, "O = \u221249.07"), codes=(2,)), reach("whose spaces are no spaces", ("duration_s = ", "duration_s\u00a0=\u00a0"), codes=(2,)), reach("whose lines end in U+2028", ("\n[objective]", "\u2028[objective]"), codes=(2,)),
    reach("of a joint in its table and a number beside", (START, "O = -49.07, O2 = [1]"), codes=(2,)), reach("of a table for a number", ("0.16", "{ s = 0.16 }"), codes=(2,)), reach("of a list for a number", ("0.16", "[0.16]"), codes=(2,)), reach("of a list of mixed types", extra='\n[limits]\neffort = { act_O = [-5, "5"] }\n', codes=(2,)), reach("of a text for a number", ("0.16", '"0.16"'), codes=(2,)), reach("of a time of day", ("0.16", "07:32:00"), codes=(2,)), reach("of a list for a word", ('"reach"', '["reach"]'), codes=(2,)), reach("of an empty word", ('"reach"', '""'), codes=(2,)), reach("whose mechanism is a list of tables", ("[mechanism]", "[[mechanism]]"), codes=(2,)), reach("whose start is a list of tables", ("start_deg = { O = -49.07 }", "start_deg = [{ O = -49.07 }]"), codes=(2,)), reach("whose waypoints are a table", extra="\n[motion.waypoints]\nat_deg = { O = 1.0 }\n", codes=(2,)), reach("whose waypoints are mixed", ("kind =", "waypoints = [{ at_deg = { O = 1.0 } }, 5, true]\nkind ="), codes=(2,)), reach("whose terms are mixed", ('minimize = "effort"', 'minimize = { effort = 1, time = "1" }'), codes=(2,)), reach("whose terms are nothing", ('minimize = "effort"', "minimize = { effort = 0.0 }"), codes=(2,)), reach("whose terms nearly cancel", ('minimize = "effort"', "minimize = { effort = 5e-324, work = 1e-300 }")), reach("whose gains are truth", ("kp = 200.0", "kp = true"), codes=(2,)),
    batch("of two values that are one", "[sweep]\n'motion.duration_s' = [0.16, 0.16]\n"), batch("of values a rounding apart", "[sweep]\n'motion.duration_s' = [0.16, 0.16000000000000003]\n"), batch("of no values", "[sweep]\n'motion.duration_s' = []\n", (2,)), batch("from a value to itself", "[sweep]\n'motion.duration_s' = { from = 0.16, to = 0.16, count = 2 }\n"), batch("of one step", "[sweep]\n'motion.duration_s' = { from = 0.16, to = 0.2, count = 1 }\n"), batch("of names that one normal form makes one", '[[case]]\nname = "\u00e9"\n[[case]]\nname = "e\u0301"\n'), batch("of a case named as a folder of ours", '[[case]]\nname = "out.unfinished"\n'), batch("of a case named as a device", '[[case]]\nname = "CON"\n'), batch("of a case of the same key twice", '[[case]]\nname = "a"\nset = ["motion.goal_deg.O=20", "motion.goal_deg.O=25"]\n'), batch("of a sweep and cases", "[sweep]\n'motion.duration_s' = [0.16, 0.2]\n[[case]]\nname = 'a'\n"), batch("of a case that is a number", "case = 5\n", (2,)), batch("of a case that sets nothing", "[[case]]\nname = 'a'\nset = ['']\n", (2,)), batch("of wrong and right cases", "[[case]]\nname = 'a'\nset = ['motion.goal_deg.O=20']\n[[case]]\nname = 'b'\nset = ['motion.goal_deg.X=20']\n"),
)
EDGES = (*NUMBERS, *LOOKS)

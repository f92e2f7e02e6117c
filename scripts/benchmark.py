"""Speed of map_racing against naive references, measured in one run; called by scripts/benchmark.

Each reference is the obvious way to do the same work, written here from its description. Two
programs that are compared take turns, and medians are used, so that other load on the machine
affects both equally; for the same reason all times are processor time on one core, except for the
season.
"""

import json
import math
import os
import platform
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

sys.path.append(str(Path(__file__).resolve().parent.parent / "src"))
from map_racing.start import without_traceback

with without_traceback():
    import numpy as np
    from distributed import Client, LocalCluster
    from scipy.integrate import odeint

    from map_racing.bags.writer import BagWriter
    from map_racing.control.controller import Controller, build_controller
    from map_racing.control.parameters import load_controller_parameters
    from map_racing.control.steering import build_steering_map
    from map_racing.evaluation.recordings import load_recording, recorded_raceline
    from map_racing.evaluation.runs import evaluate
    from map_racing.experiments.executors import open_executor
    from map_racing.experiments.season import BagOptions, evaluate_season
    from map_racing.experiments.season_bags import find_bags
    from map_racing.simulation.plant import Localization, Plant
    from map_racing.simulation.plants import load_plant
    from map_racing.simulation.race import race
    from map_racing.simulation.recorded import write_race_bag
    from map_racing.track.files.load import load_raceline
    from map_racing.track.files.waypoints import waypoint_rows
    from map_racing.track.raceline import Raceline
    from map_racing.vehicle.grids import published_grid
    from map_racing.vehicle.parameters import load_vehicle
    from map_racing.vehicle.steady_state import steady_state_table

    # ROS 2 bags are made as in the tests.
    sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "unit" / "bags"))
    from ros2_bags import messages_of, write_mcap, write_sqlite

SYSTEM_PYTHON = "/usr/bin/python3"  # has the rosbag package of Debian or ROS
EVALUATE = "--evaluate"  # this program calls itself with it, to evaluate a bag in a new process
SPEED_SCALE = 0.7  # the shipped controllers lap the reference track cleanly at this speed


def main(only=None, recording=None):
    """Run all comparisons, or one, and print one table."""
    rows, remarks = [], []
    vehicle, raceline = load_vehicle("nuc4"), load_raceline("reference")
    with tempfile.TemporaryDirectory() as folder:
        parts = {
            "table": lambda: compare_table(vehicle),
            "controller": lambda: compare_controller(vehicle, raceline),
            "adaptation": lambda: compare_adaptation(vehicle, raceline),
            "recording": lambda: compare_recording(vehicle, raceline, Path(folder), recording),
            "formats": lambda: compare_formats(vehicle, raceline, Path(folder)),
            "hour": lambda: compare_hour(raceline, Path(folder)),
            "season": lambda: compare_season(vehicle, raceline, Path(folder)),
            "simulation": lambda: compare_simulation(vehicle, raceline),
        }
        if only is not None and only not in parts:
            sys.exit(f"benchmark: --only: expected one of {', '.join(parts)}, got {only}")
        for compare in [parts[only]] if only else parts.values():
            more_rows, more_remarks = compare()
            rows += more_rows
            remarks += more_remarks
            print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(
        f"{platform.python_implementation()} {platform.python_version()}, "
        f"numpy {np.__version__}; times are processor time\n"
    )
    header = ("what", "map_racing", "reference", "ratio", "goal", "met")
    rows = [row[:-1] + ("yes" if row[-1] else "NO",) for row in rows]
    widths = [max(map(len, column)) for column in zip(header, *rows)]
    for row in (header, tuple("-" * width for width in widths), *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
    print("\nHow it was measured:")
    for remark in remarks:
        print(f"- {remark}")


def timed(function, *arguments):
    """Processor time of a call [s], and its result."""
    begin = process_time()
    result = function(*arguments)
    return process_time() - begin, result


# -- steady-state table --------------------------------------------------------------------------


def integrate_cell(vehicle, v, delta):
    """Lateral acceleration [m/s^2] after 2 s at constant speed and steering angle."""
    front, rear, mu = vehicle.front, vehicle.rear, vehicle.mu
    weight = vehicle.m * 9.81 / vehicle.l_wb
    load_f, load_r = weight * vehicle.l_r, weight * vehicle.l_f

    def force(tire, load, slip):
        x = tire.B * slip
        return mu * load * tire.D * math.sin(tire.C * math.atan(x - tire.E * (x - math.atan(x))))

    def right_hand_side(state, _):
        v_y, r = state
        force_f = force(front, load_f, delta - math.atan((v_y + r * vehicle.l_f) / v))
        force_r = force(rear, load_r, -math.atan((v_y - r * vehicle.l_r) / v))
        return (
            (force_f + force_r) / vehicle.m - v * r,
            (vehicle.l_f * force_f - vehicle.l_r * force_r) / vehicle.I_z,
        )

    states = odeint(right_hand_side, (0.0, 0.0), np.arange(0.0, 2.0, 0.01))
    return v * states[-1, 1]


def compare_table(vehicle):
    """Table on the published grid, compared with integrating each cell."""
    speeds, angles = published_grid()
    ours, reference, apart = [], 0.0, 0.0
    for i, delta in enumerate(angles):
        seconds, table = timed(steady_state_table, vehicle, speeds, angles)
        ours.append(seconds)
        for v, expected in zip(speeds, table.a_lat[i]):
            seconds, a_lat = timed(integrate_cell, vehicle, v, delta)
            reference += seconds
            if math.isfinite(expected):
                apart = max(apart, abs(a_lat - expected))
    seconds = statistics.median(ours)
    row = (
        f"steady-state table, {angles.size} x {speeds.size} cells",
        f"{1e3 * seconds:.1f} ms",
        f"{reference:.1f} s (odeint, 2 s a cell)",
        f"{reference / seconds:.0f}",
        ">= 300",
        reference >= 300.0 * seconds,
    )
    remark = (
        f"table: odeint integrates every cell, with plain floats in its right-hand side; the table "
        f"is made anew for each angle in between, median of {len(ours)}. Where the table has a "
        f"value they agree to {apart:.0e} m/s^2."
    )
    return [row], [remark]


# -- controller ----------------------------------------------------------------------------------


class NaiveController:
    """MAP on vertices and the nearest column of the table, in numpy, like public controllers.

    The position is copied once per point to compute distances; the lookahead point is the first
    vertex at the lookahead distance from the nearest one; the angle comes from the two nearest
    cells of the column.
    """

    def __init__(self, parameters, table, raceline, count, delta_max):
        curve = raceline.sample(np.arange(count) * raceline.length / count)
        self.points = np.column_stack((curve.x, curve.y))
        self.speeds = curve.speed * parameters.speed_scale
        self.parameters, self.table, self.delta_max = parameters, table, delta_max

    def step(self, state):
        """Steering angle [rad] and speed [m/s]."""
        points, law = self.points, self.parameters
        position = np.array((state.x, state.y))
        offsets = np.array([position] * len(points)) - points
        nearest = np.argmin(np.linalg.norm(offsets, axis=1))
        speed = self.speeds[nearest]
        lookahead = np.clip(law.m_m + law.q_s * speed, law.lookahead_min_m, law.lookahead_max_m)
        ahead = nearest
        while np.linalg.norm(points[ahead] - points[nearest]) < lookahead:
            ahead = (ahead + 1) % len(points)
        to_point = points[ahead] - position
        distance = np.linalg.norm(to_point)
        to_left = np.array((-np.sin(state.psi), np.cos(state.psi)))
        eta = np.arcsin(np.dot(to_point, to_left) / distance)
        angle = self.look_up(speed, 2.0 * speed**2 / distance * np.sin(eta))
        return np.clip(angle, -self.delta_max, self.delta_max), speed

    def look_up(self, v, a_lat):
        """Steering angle [rad] in the column of the nearest speed."""
        table, wanted = self.table, np.abs(a_lat)
        column = table[1:, 1 + np.argmin(np.abs(table[0, 1:] - v))]
        unstable = np.flatnonzero(np.isnan(column))
        if unstable.size:
            column = column[: unstable[0]]
        first = np.argmin(np.abs(column - wanted))
        if 0 < first < column.size - 1:
            beside = first + np.array((-1, 1))
            second = beside[np.argmin(np.abs(column[beside] - wanted))]
            cells = np.sort((first, second))
            angle = np.interp(wanted, column[cells], table[1 + cells, 0])
        else:
            angle = table[1 + first, 0]
        return np.sign(a_lat) * angle


def compare_controller(vehicle, raceline):
    """A controller step, compared with the naive one and on a far denser raceline."""
    parameters = load_controller_parameters("map").with_(speed_scale=SPEED_SCALE)
    states = [sample.measured for sample in drive(vehicle, raceline, laps=7).samples]

    def ours(count):
        curve = raceline.sample(np.arange(count) * raceline.length / count)
        line = Raceline(
            curve.x, curve.y, vx_mps=curve.speed, d_left_m=curve.d_left, d_right_m=curve.d_right
        )
        return Controller(parameters, steering_map, vehicle, line)

    steering_map = build_steering_map(parameters.steering_map, vehicle, parameters.v_max_mps)
    table = steady_state_table(vehicle, *published_grid())
    table = np.block([[0.0, table.speeds], [table.angles[:, None], table.a_lat]])
    controllers = (
        ours(400),
        NaiveController(parameters, table, raceline, 400, vehicle.delta_max),
        ours(20000),
    )
    apart = math.sqrt(
        statistics.mean(
            (controllers[0].step(state).steering_angle - controllers[1].step(state)[0]) ** 2
            for state in states
        )
    )
    turn, passes = 200, 8
    times = times_in_turns(controllers, states, turn, passes)
    step, naive, dense = (1e6 * statistics.median(seconds) for seconds in times)
    faster = statistics.median(b / a for a, b in zip(times[0], times[1]))
    denser = statistics.median(b / a for a, b in zip(times[0], times[2]))
    rows = [
        (
            "controller step, 400 points",
            f"{step:.1f} us",
            f"{naive:.0f} us (numpy over all points)",
            f"{faster:.1f}",
            ">= 8",
            faster >= 8.0,
        ),
        ("  the aim for it", f"{step:.1f} us", "", "", "<= 15 us", step <= 15.0),
        (
            "controller step, 20,000 points",
            f"{dense:.1f} us",
            f"{step:.1f} us (400 points)",
            f"{denser:.2f}",
            "0.8 to 1.2",
            0.8 <= denser <= 1.2,
        ),
    ]
    remark = (
        f"controller: all drive the same {len(states)} states of a simulated race at 40 Hz, "
        f"{passes} times, in turns of {turn} states; medians over the turns. The reference neither "
        f"predicts nor limits the steering rate; its angles are {apart:.3f} rad (RMS) from ours."
    )
    return rows, [remark]


def times_in_turns(controllers, states, turn, passes):
    """Step times of three controllers [s], one for each turn.

    Turns last five seconds of driving, so that the caches left by another program hardly matter;
    each controller follows each of the others equally often.
    """
    times = [[], [], []]
    for number in range(passes):
        order = (0, 1, 2) if number % 2 else (2, 1, 0)
        for begin in range(0, len(states) - turn + 1, turn):
            batch = states[begin : begin + turn]
            for which in order:
                seconds = timed(step_through, controllers[which], batch)[0]
                times[which].append(seconds / turn)
    return times


def compare_adaptation(vehicle, raceline):
    """What adaptation adds to a controller step."""
    states = [sample.measured for sample in drive(vehicle, raceline, laps=7).samples]
    parameters = load_controller_parameters("map_adaptive").with_(speed_scale=SPEED_SCALE)
    both = [
        build_controller(parameters.with_(adaptation=on), vehicle, raceline) for on in (True, False)
    ]
    turn, passes = 200, 8
    times = [], []
    for number in range(passes):
        for begin in range(0, len(states) - turn + 1, turn):
            batch = states[begin : begin + turn]
            for which in (0, 1) if number % 2 else (1, 0):
                times[which].append(timed(step_through, both[which], batch)[0] / turn)
    learning, plain = (1e6 * statistics.mean(seconds) for seconds in times)
    row = (
        "controller step with adaptation",
        f"{learning:.1f} us",
        f"{plain:.1f} us (without)",
        f"+{learning - plain:.0f} us",
        "<= 100 us more",
        learning - plain <= 100.0,
    )
    remark = (
        f"adaptation: both drive the same {len(states)} states at 40 Hz, {passes} times, in turns "
        f"of {turn} states; means, as a step in a bend takes longer than one on a straight."
    )
    return [row], [remark]


def step_through(controller, states):
    """Step a controller through states."""
    step = controller.step
    for state in states:
        step(state)


# -- evaluation ----------------------------------------------------------------------------------

ROSBAG_READS = """
import sys, time
import rosbag
begin = time.process_time()
with rosbag.Bag(sys.argv[1]) as bag:
    for _ in bag.read_messages(topics=[sys.argv[2]]):
        pass
print(time.process_time() - begin)
"""

ROSBAGS_READS = """
import pathlib, sys, time
from rosbags.highlevel import AnyReader
begin = time.process_time()
with AnyReader([pathlib.Path(sys.argv[1])]) as reader:
    wanted = [c for c in reader.connections if c.topic == sys.argv[2]]
    for connection, _, data in reader.messages(connections=wanted):
        reader.deserialize(data, connection.msgtype)
print(time.process_time() - begin)
"""


def evaluate_bag(path):
    """In a separate process: evaluate a bag, and print time, memory and laps as JSON."""

    def work():
        recording = load_recording(path)
        return recording, evaluate(recording, recorded_raceline(recording))

    seconds, (recording, result) = timed(work)
    figures = {
        "seconds": seconds,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "topic": recording.topic,
        "samples": recording.t.size,
        "duration": float(recording.t[-1]),
        "laps": result.summary.laps_completed,
    }
    print(json.dumps(figures))


def run(command):
    """JSON output of a program."""
    return json.loads(subprocess.check_output([str(word) for word in command]))


def run_evaluation(path):
    """Figures of `evaluate_bag`."""
    return run([sys.executable, __file__, EVALUATE, path])


def compare_recording(vehicle, raceline, folder, recording=None):
    """Evaluating a bag (by default of a simulated race), compared with only reading its poses."""
    bag, what = recording, f"{recording}"
    if recording is None:
        bag, what = folder / "race.bag", "a simulated race"
        # As many poses as in some twelve laps at 100 Hz.
        write_race_bag(bag, drive(vehicle, raceline, laps=15), raceline)
    can_rosbag = [SYSTEM_PYTHON, "-c", "import rosbag"]
    has_rosbag = (
        Path(SYSTEM_PYTHON).exists()
        and subprocess.run(can_rosbag, stderr=subprocess.DEVNULL, check=False).returncode == 0
    )
    if has_rosbag:
        name, reads = "rosbag", [SYSTEM_PYTHON, "-c", ROSBAG_READS]
    else:
        name, reads = "rosbags", [sys.executable, "-c", ROSBAGS_READS]
    ours, reference = [], []
    for _ in range(7):
        figures = run_evaluation(bag)
        ours.append(figures["seconds"])
        reference.append(run([*reads, bag, figures["topic"]]))
    ratio = statistics.median(a / b for a, b in zip(ours, reference))
    row = (
        f"evaluating {figures['duration']:.0f} s of driving",
        f"{statistics.median(ours):.3f} s",
        f"{statistics.median(reference):.3f} s ({name} reading poses)",
        f"{ratio:.2f}",
        "<= 0.5",
        ratio <= 0.5,
    )
    remark = (
        f"evaluation: {what} with {figures['samples']} poses and {figures['laps']} laps, from "
        f"opening the bag to the laps; {name} only reads {figures['topic']}. Each runs seven times "
        "in new processes, in turns; the time of imports is left out for both."
    )
    return [row], [remark]


def compare_hour(raceline, folder):
    """Evaluation and report of an hour at 100 Hz."""
    bag = folder / "hour.bag"
    count, v = 360000, 5.0
    t = np.arange(count) / 100.0
    s = v * t
    x, y = raceline.to_cartesian(s, 0.1 * np.sin(0.7 * s))
    at = raceline.sample(s)
    columns = (t + 1.0, x, y, at.psi, v * at.kappa)
    with BagWriter(bag, compression="lz4") as writer:
        writer.waypoints(1.0, waypoint_rows(raceline))
        for number, (stamp, *pose, rate) in enumerate(zip(*(c.tolist() for c in columns))):
            writer.odometry(stamp, *pose, v, 0.0, rate)
            if number % 2:
                writer.drive(stamp, 0.32 * rate / v, v)
    figures = run_evaluation(bag)
    seconds, megabytes = figures["seconds"], figures["megabytes"]
    page, children = folder / "hour.html", resource.getrusage(resource.RUSAGE_CHILDREN)
    report = ["-m", "map_racing", "report", bag, "--vehicle", "nuc4", "--output", page]
    begin = perf_counter()
    subprocess.run([sys.executable, *map(str, report)], stdout=subprocess.DEVNULL, check=True)
    wall, after = perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - children.ru_utime - children.ru_stime
    size = 1e-6 * page.stat().st_size
    rows = [
        ("evaluating an hour at 100 Hz", f"{seconds:.1f} s", "", "", "< 15 s", seconds < 15.0),
        ("  peak memory", f"{megabytes:.0f} MB", "", "", "< 500 MB", megabytes < 500.0),
        (
            "report of that hour",
            f"{spent:.1f} s",
            f"{wall:.1f} s (wall)",
            "",
            "< 30 s",
            spent < 30.0,
        ),
        ("  its page", f"{size:.2f} MB", "", "", "< 6 MB", size < 6.0),
    ]
    remark = (
        f"hour: {figures['samples']} odometry messages and half as many commands made for it, "
        f"{figures['laps']} laps; peak "
        "memory is that of the whole process, libraries and traces for the figures included. The "
        "report is a program of its own, from its start to the page."
    )
    return rows, [remark]


def compare_formats(vehicle, raceline, folder):
    """A ROS 2 bag, compared with the same run in a ROS 1 bag."""
    ros1 = folder / "formats.bag"
    write_race_bag(ros1, drive(vehicle, raceline, laps=7), raceline)
    messages = list(messages_of(ros1))
    rows = []
    for name, path in (
        ("sqlite3", write_sqlite(folder / "formats", messages)),
        ("MCAP", write_mcap(folder / "formats.mcap", messages)),
    ):
        ours, reference = [], []
        for _ in range(15):
            ours.append(timed(evaluated, path)[0])
            reference.append(timed(evaluated, ros1)[0])
        ratio = statistics.median(ours) / statistics.median(reference)
        rows.append(
            (
                f"evaluating a bag of ROS 2 ({name})",
                f"{statistics.median(ours):.3f} s",
                f"{statistics.median(reference):.3f} s (ROS 1)",
                f"{ratio:.2f}",
                "<= 1.2",
                ratio <= 1.2,
            )
        )
    remark = (
        f"formats: the same {len(messages)} messages, from opening the bag to the laps, in turns "
        "in this process, medians of 15; the bag of ROS 1 is not compressed either."
    )
    return rows, [remark]


def evaluated(bag):
    """Laps of a bag."""
    recording = load_recording(bag)
    return evaluate(recording, recorded_raceline(recording))


def compare_season(vehicle, raceline, folder, count=240, rounds=3):
    """A season's bags on a local Dask cluster, doubling the workers each time."""
    bags = folder / "season"
    bags.mkdir()
    one = folder / "heat.bag"
    write_race_bag(one, drive(vehicle, raceline, laps=6), raceline)
    for number in range(count):
        shutil.copyfile(str(one), f"{bags}/heat_{number}.bag")
    cores = len(os.sched_getaffinity(0))
    numbers = [2**k for k in range(cores.bit_length()) if 2**k <= cores]
    times = {workers: math.inf for workers in numbers}
    beside, here = 0.0, 0.0
    for _ in range(rounds):
        for workers in numbers:
            seconds, own, others = timed_season(find_bags([bags]), workers)
            times[workers] = min(times[workers], seconds)
            if workers > 1:
                here, beside = here + own, beside + others
    rows = []
    for workers, seconds in times.items():
        before = times.get(workers // 2)
        rows.append(
            (
                f"season of {count} bags of 60 s, {workers} workers",
                f"{seconds:.1f} s",
                f"{before:.1f} s ({workers // 2} workers)" if before else "",
                f"{before / seconds:.2f}" if before else "",
                ">= 1.7" if before else f"< {0.36 * count:.0f} s",
                before >= 1.7 * seconds if before else seconds < 0.36 * count,
            )
        )
    remark = (
        "season: wall time on a local Dask cluster with one thread a worker, in turns, the best of "
        f"{rounds}, from the first bag to the table; the workers are running and have each "
        "evaluated a bag before. 1,000 bags in 3 minutes on two cores are 0.36 s a bag and core. "
        "Other load on the machine counts here"
    )
    if beside:
        remark += (
            f"; scheduler and table take {100.0 * here / (here + beside):.0f} % of the processor "
            "time, also of the cores of the workers."
        )
    return rows, [remark]


def timed_season(bags, workers):
    """Wall time of a season on a new cluster; processor times here and of the workers [s]."""
    options = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client, open_executor(
        scheduler=cluster.scheduler_address
    ) as (executor, capacity), tempfile.TemporaryDirectory() as folder:
        client.run(evaluated, bags[0])  # each worker imports the package, and opens a bag
        before = sum(client.run(process_time).values())
        own, begin = process_time(), perf_counter()
        evaluate_season(bags, Path(folder) / "season", BagOptions(), executor, capacity)
        seconds, own = perf_counter() - begin, process_time() - own
        return seconds, own, sum(client.run(process_time).values()) - before


# -- simulation ----------------------------------------------------------------------------------


def drive(vehicle, raceline, laps):
    """A race of MAP with the shipped plant."""
    parameters = load_controller_parameters("map").with_(speed_scale=SPEED_SCALE)
    plant = load_plant("nuc4")
    controller = build_controller(parameters, vehicle, raceline)
    return race(Plant(plant), controller, raceline, Localization(plant, seed=1), laps=laps)


def compare_simulation(vehicle, raceline):
    """Plant, localization and controller in closed loop, compared with real time."""
    runs = [timed(drive, vehicle, raceline, 7) for _ in range(3)]
    seconds = statistics.median(run[0] for run in runs)
    duration = runs[0][1].duration
    row = (
        "simulated race, plant and controller",
        f"{seconds:.2f} s",
        f"{duration:.0f} s (real time)",
        f"{duration / seconds:.0f}",
        ">= 50",
        duration >= 50.0 * seconds,
    )
    remark = (
        "simulation: plant at 500 Hz, localization and controller at 40 Hz, one core, including "
        "the time to make the controller's table; median of three races."
    )
    return [row], [remark]


if __name__ == "__main__":
    with without_traceback():
        if sys.argv[1:2] == [EVALUATE]:
            evaluate_bag(sys.argv[2])
        elif sys.argv[1:2] == ["--only"]:
            main(*sys.argv[2:4])
        else:
            main(None, *sys.argv[1:2])

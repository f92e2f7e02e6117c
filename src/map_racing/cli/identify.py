"""``map-racing identify``: from recorded driving to a vehicle file and its lookup table."""

import dataclasses
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .. import __version__
from ..errors import ParameterError
from ..files import make_folder, replacing
from ..identification.cornering import SteadyLimits
from ..identification.data import Channel, ChannelMap, load_channel_map, load_run
from ..identification.identify import identify, leave_one_out
from ..identification.report import report_data, report_text
from ..resources import list_config
from ..vehicle.lookup import default_grid
from ..vehicle.parameters import load_vehicle, parameter_hash, save_vehicle
from ..vehicle.steady_state import steady_state_table
from .outputs import check_outputs


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser(
        "identify",
        help="identify tires from recorded steady cornering, write vehicle file and table",
        description="Identify the tires of a car from recordings of steady cornering: ramps of the "
        "steering angle or circles at steady speeds. Writes the vehicle file and, beside it, its "
        "lookup table (.csv). Data that cannot identify tires are refused with the reason.",
    )
    parser.add_argument(
        "data", nargs="+", metavar="DATA", help="ROS 1 bags, or CSV files with --channels"
    )
    parser.add_argument(
        "--vehicle",
        required=True,
        help="the car as it is known: mass, geometry, and tires for what the data do not determine "
        "(shipped vehicle or YAML file)",
    )
    parser.add_argument("--output", required=True, metavar="YAML", help="vehicle file to write")
    parser.add_argument(
        "--linear-output", metavar="YAML", help="write the car with linear tires by regression, too"
    )
    parser.add_argument("--name", help="of the identified car (default: that of the file)")
    parser.add_argument(
        "--channels",
        metavar="YAML",
        help="which column or topic holds what: a file, or shipped: "
        + ", ".join(list_config("channels")),
    )
    parser.add_argument("--pose-topic", metavar="TOPIC", help="of a bag (default: found)")
    parser.add_argument(
        "--servo-topic",
        metavar="TOPIC",
        help="take the steering angle from a servo's position (std_msgs/Float64) instead of the "
        "drive command",
    )
    parser.add_argument(
        "--servo-gain",
        type=float,
        default=-1.2135,
        help="position = gain * angle + offset, as in the VESC's configuration (default: "
        "%(default)s)",
    )
    parser.add_argument(
        "--servo-offset", type=float, default=0.5304, help="see above (default: %(default)s)"
    )
    parser.add_argument(
        "--steering-delay",
        type=float,
        metavar="S",
        help="from the command to the wheels [s], also in a channel map (default: 0; at 0.02 rad/s "
        "50 ms are 1 mrad)",
    )
    parser.add_argument(
        "--fix",
        action="store_true",
        help="correct signs, axes, scales, offsets and steering gain that contradict physics",
    )
    parser.add_argument(
        "--leave-one-out",
        action="store_true",
        help="also predict each run from the others, and report the error",
    )
    parser.add_argument(
        "--acceleration",
        choices=("imu", "yaw_rate"),
        default="imu",
        help="lateral acceleration of the IMU, or speed times yaw rate (default: %(default)s)",
    )
    parser.add_argument(
        "--front-force",
        choices=("model", "paper"),
        default="model",
        help="front force as the model of the table needs it, or divided by the cosine of the "
        "steering angle as in the paper (default: %(default)s)",
    )
    limits = SteadyLimits()
    for option, name, what in (
        ("--cutoff", "cutoff_hz", "of the low-pass [Hz]"),
        ("--steady-dv", "dv_mps2", "largest change of speed that counts as steady [m/s^2]"),
        ("--steady-dr", "dr_radps2", "of yaw rate [rad/s^2]"),
        ("--steady-ddelta", "ddelta_radps", "of steering angle [rad/s]"),
        ("--steady-time", "shortest_s", "shortest steady stretch [s]"),
    ):
        parser.add_argument(
            option,
            dest=name,
            type=float,
            default=getattr(limits, name),
            metavar="X",
            help=f"{what} (default: %(default)s)",
        )
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON")
    parser.add_argument("--plots", metavar="DIR", help="write figures")
    parser.set_defaults(run=run)


def run(arguments):
    """Identify, report, write."""
    output = Path(arguments.output)
    if output.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"{output}: expected a vehicle file that ends in .yaml")
    table_path = output.with_suffix(".csv")
    outputs = [arguments.output, str(table_path), arguments.linear_output, arguments.json]
    check_outputs(outputs, [*arguments.data, arguments.vehicle, arguments.channels])
    base = load_vehicle(arguments.vehicle)
    channels = channel_map(arguments)
    runs = [
        load_run(path, channels) for path in tqdm(arguments.data, "read", disable=None, leave=False)
    ]
    names = [field.name for field in dataclasses.fields(SteadyLimits)]
    options = {
        "fix": arguments.fix,
        "limits": SteadyLimits(**{name: getattr(arguments, name) for name in names}),
        "front_force": arguments.front_force,
        "acceleration": arguments.acceleration,
        "name": arguments.name or output.stem,
    }
    found = identify(runs, base, **options)
    holds = leave_one_out(runs, base, **options) if arguments.leave_one_out else None
    for recorded in runs:
        for note in recorded.notes:
            print(f"{recorded.label}: {note}")
    print(report_text(found, holds))

    if arguments.plots:
        # Before the first output, so that none is left behind where it cannot be made.
        make_folder(arguments.plots)
    print()
    table = steady_state_table(found.vehicle, *default_grid(found.vehicle))
    save_vehicle(found.vehicle, output, provenance(found))
    table.save(table_path)
    print(f"vehicle written to {output} ({parameter_hash(found.vehicle)}), table to {table_path}")
    if arguments.linear_output:
        save_vehicle(found.linear_vehicle, arguments.linear_output, provenance(found))
        print(f"vehicle with linear tires written to {arguments.linear_output}")
    if arguments.json:
        with replacing(arguments.json) as file:
            json.dump(report_data(found, holds), file, indent=1, allow_nan=False)
            file.write("\n")
        print(f"report written to {arguments.json}")
    if arguments.plots:
        draw(arguments.plots, found, holds, table)
        print(f"figures are in {arguments.plots}")


def channel_map(arguments):
    """The channel map, with what the command line says of it."""
    channels = load_channel_map(arguments.channels) if arguments.channels else ChannelMap()
    if arguments.pose_topic:
        channels = dataclasses.replace(channels, pose_topic=arguments.pose_topic)
    if arguments.servo_topic:
        gain, offset = arguments.servo_gain, arguments.servo_offset
        if not gain:
            raise ParameterError("--servo-gain must not be 0")
        steering = Channel(arguments.servo_topic, scale=1.0 / gain, offset=-offset / gain)
        merged = {**channels.channels, "steering": steering}
        channels = dataclasses.replace(channels, channels=merged)
    if arguments.steering_delay is not None:
        setup = dataclasses.replace(channels.setup, steering_delay_s=arguments.steering_delay)
        channels = dataclasses.replace(channels, setup=setup)
    return channels


def provenance(found):
    """Lines for the head of the vehicle file."""
    runs = ", ".join(motion.run.label for motion in found.motions)
    front, rear = found.front, found.rear
    return (
        f"Tires identified by map_racing {__version__} from {runs}; the rest is of "
        f"{found.base.name}.\n"
        f"Held {found.largest_a_y:.2f} m/s^2; slip angles to {front.covered_slip:.3f} rad in front "
        f"and {rear.covered_slip:.3f} rad behind; peak "
        f"{'reached' if front.saturated else 'not reached'} in front, "
        f"{'reached' if rear.saturated else 'not reached'} behind.\n"
        f"Steering: wheel angle = {found.setup.steering_gain:.4f} * signal "
        f"{found.setup.steering_offset_rad:+.4f} rad."
    )


def draw(folder, found, holds, table):
    """All figures."""
    # matplotlib takes a second, and most calls draw nothing
    from ..plots import identification as plots
    from ..plots.lookup import plot_lookup_curves, plot_lookup_surface
    from ..plots.style import save

    folder = make_folder(folder)
    axles = []
    for name in ("front", "rear"):
        points, fit = getattr(found, name + "_points"), getattr(found, name)
        linear = getattr(found, name + "_linear").tire
        axles.append(
            plots.AxleFigure(
                *(name, -points.slip, points.force, fit.inlier),
                *(_force(fit.tire, points.load), _force(linear, points.load)),
                *(fit.covered_slip, points.load),
            )
        )
    v, delta, a_y = (
        np.concatenate([getattr(m, key)[cut][::5] for m in found.motions for cut in m.segments()])
        for key in ("v_x", "delta", "a_y")
    )
    predicted = holds if holds is not None else found.holds()
    title = "the runs left out, by the others" if holds is not None else "the data fitted to"
    grid = table.speeds, table.angles, table.a_lat
    figures = [
        ("tires.png", plots.plot_tires, (axles,)),
        ("coverage.png", plots.plot_coverage, (v, delta, a_y, found.largest_a_y)),
        (
            "prediction.png",
            plots.plot_prediction,
            (
                [hold.run for hold in predicted],
                [(hold.r, hold.a_y) for hold in predicted],
                [(hold.r_predicted, hold.a_y_predicted) for hold in predicted],
                f"Steady cornering, predicted: {title}",
            ),
        ),
        ("lookup_surface.png", plot_lookup_surface, grid),
        ("lookup_curves.png", plot_lookup_curves, grid),
    ]
    for number, m in enumerate(found.motions, 1):
        drive = plots.DriveFigure(m.run.label, m.t, m.v_x, m.delta, m.r, m.a_y, m.segments())
        figures.append((f"run_{number}.png", plots.plot_drive, (drive,)))
    for file_name, plot, values in tqdm(figures, desc="figures", disable=None, leave=False):
        save(plot(*values), folder / file_name)


def _force(tire, load):
    return lambda slip: load * tire.normalized_force(slip)

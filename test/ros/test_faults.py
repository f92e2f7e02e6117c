"""Faults by name on the running nodes: simulator and controller."""

import math

import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray
from harness import wait_for
from map_racing.srv import InjectFault

# A schedule whose fault ends before the car moves.
SCHEDULE = "faults: [{fault: pose_nan, at_s: 0.1, for_s: 0.2}]\n"


@pytest.fixture
def nodes(ros, start, listen, tmp_path):
    """Simulator and controller in real time; gives the controller's messages, and the service."""
    path = tmp_path / "faults.yaml"
    path.write_text(SCHEDULE)
    diagnostics = listen("/diagnostics", DiagnosticArray)
    drive = listen("/drive", AckermannDriveStamped)
    limits = {"max_pose_age_s": 0.8, "max_deviation_m": 5.0}
    controller = start("controller", {"raceline": "reference", **limits})
    simulator = start("simulator", {"faults": str(path)})
    ros.wait_for_service("/simulator/inject_fault", 10.0)
    return (
        controller,
        simulator,
        drive,
        diagnostics,
        ros.ServiceProxy("/simulator/inject_fault", InjectFault),
    )


def test_faults_by_name(nodes):
    controller, simulator, drive, diagnostics, inject = nodes

    def wait_mode(mode, reason=""):
        def now():
            ours = [a.status[0] for a in list(diagnostics) if "controller" in a.status[0].name]
            values = {pair.key: pair.value for pair in ours[-1].values} if ours else {}
            return (values.get("mode"), values.get("reason")) == (mode, reason)

        wait_for(now, 20.0, f"{mode}: {reason}")

    wait_for(lambda: "fault ends: pose_nan" in simulator.output, what="the end of the schedule")
    wait_mode("driving")

    answer = inject("magic", 0.0, 0.0)
    assert not answer.success and "got 'magic'" in answer.message
    answer = inject("pose_jump", 0.0, 1e3)
    assert not answer.success and "size: expected -100 to 100 m for pose_jump" in answer.message
    answer = inject("stop_requested", 0.0, 0.0)
    told = "stop_requested: only map-racing race injects it, not the node simulator"
    assert (answer.success, answer.message) == (False, told)

    assert inject("pose_frame", 0.0, 0.0).message == "pose_frame"
    wait_mode("stopped", "pose in another frame")
    assert inject("", 0.0, 0.0).message == "all faults end"
    wait_mode("driving")

    # The second publisher is another node: the first counts, the log names both.
    assert inject("second_publisher", 0.0, 3.0).success
    text = "/odom: /simulator_second publishes it, too; only /simulator counts"
    wait_for(lambda: text in controller.output, 20.0, "the error")
    inject("", 0.0, 0.0)
    wait_for(lambda: "fault ends: second_publisher" in simulator.output, what="its end")
    wait_mode("driving")

    assert inject("pose_dropout", 2.0, 0.0).success
    wait_mode("stopped", "pose too old")
    wait_mode("driving")
    assert inject("blocked", 0.0, 0.0).success
    since = controller.output.count("stopp")
    wait_for(lambda: controller.output.count("stopp") > since, 20.0, "the stop")
    for message in list(drive):
        assert 0.0 <= message.drive.speed <= 12.0
        assert abs(message.drive.steering_angle) < 0.42 and math.isfinite(message.drive.speed)
    assert "Traceback" not in controller.output + simulator.output

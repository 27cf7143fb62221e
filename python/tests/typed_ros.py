"""A program that type checkers accept; `test_ros.py` runs one on it."""

import array

import dca
from dca import ros
from dca.ros.sensor import LaserScan


@dca.service("Avoids.", triggered_by="Scan")
class Avoid:
    Scan = dca.In(ros.sensor.LaserScan)
    Cmd = dca.Out(ros.geometry.Twist)
    Reset = dca.Calls(ros.std_srvs.SetBool_Request, ros.std_srvs.SetBool_Response, optional=True)

    def main_calc(self, tick: dca.Tick) -> None:
        scan = self.Scan.fresh()
        if scan is None:
            return
        near: float = min(scan.ranges)
        command = ros.geometry.Twist()
        command.linear.x = near
        self.Cmd.send(command)
        self.Reset.call(ros.std_srvs.SetBool_Request(data=True), within="1 s")

    @dca.procedure
    def Set(self, request: ros.std_srvs.SetBool_Request) -> ros.std_srvs.SetBool_Response:
        return ros.std_srvs.SetBool_Response(success=request.data, message="ok")


scan = LaserScan(ranges=[1.0, 2.0], angle_min=1)
scan.ranges = array.array("f", [1.0])
image = ros.sensor.Image(data=b"abc", width=3)
image.data = bytearray(9)
size = len(image.data)
marker = ros.visualization.Marker(type=ros.visualization.Marker.CUBE)
path = ros.nav.Path(poses=[ros.geometry.PoseStamped()])
path.poses[0].pose.position.x = 1.0
goal = ros.nav2.NavigateToPose_Goal(pose=path.poses[0])

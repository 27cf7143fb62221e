#!/usr/bin/env python3
"""Drives a robot of ROS 2 on, and turns it away from what its laser sees."""

import dca
from dca import ros


@dca.service("Drives on, and turns away from what a laser sees.", every="100 ms", triggered_by="Scan")
class Avoid:
    Scan = dca.In(ros.sensor.LaserScan)
    Cmd = dca.Out(ros.geometry.Twist)
    distance = dca.parameter(dca.Length, ("0.1 m", "5 m"), default="0.5 m")

    def __init__(self):
        self.enabled = True

    def main_calc(self, tick):
        scan = self.Scan.fresh_within(tick.now, "500 ms")
        command = ros.geometry.Twist()
        if scan is not None and self.enabled:
            # A ray without an echo is infinite.
            is_near = min(scan.ranges, default=0.0) < self.distance
            command.linear.x = 0.0 if is_near else 0.3
            command.angular.z = 0.8 if is_near else 0.0
        self.Cmd.send(command)

    @dca.procedure
    def Enable(self, request: ros.std_srvs.SetBool_Request) -> ros.std_srvs.SetBool_Response:
        """Lets the base drive, or stops it."""
        self.enabled = request.data
        return ros.std_srvs.SetBool_Response(success=True, message="driving" if request.data else "standing")

    def stop(self, tick):
        self.Cmd.send(ros.geometry.Twist())
        return True


if __name__ == "__main__":
    dca.run(Avoid)

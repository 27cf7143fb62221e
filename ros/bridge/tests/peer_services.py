"""A node of ROS 2 on `zenoh-ros2-sdk`, which is independent of DCA: answers a service, and calls another one.

Arguments: the address and the port of the router. Standard input: a line of JSON with the definitions, then a line for each call.
It writes `ready` when the server is there, then the response to each call.
"""

import json
import sys

from zenoh_ros2_sdk import ROS2ServiceClient, ROS2ServiceServer
from zenoh_ros2_sdk.session import ZenohSession

address, port = sys.argv[1], int(sys.argv[2])
ZenohSession.get_instance(address, port)
service = json.loads(sys.stdin.readline())
shared = {
    "srv_type": service["type"],
    "request_definition": service["request"],
    "response_definition": service["response"],
    "type_hash": service["hash"],
    "domain_id": 7,
    "router_ip": address,
    "router_port": port,
}


def answer(request):
    return server.response_msg_class(success=request.data, message=f"it is {request.data}")


server = ROS2ServiceServer(service_name="/there", callback=answer, **shared)
client = ROS2ServiceClient(service_name="/back", timeout=30.0, **shared)
print("ready", flush=True)
for line in sys.stdin:
    response = client.call(**json.loads(line))
    told = None if response is None else {"success": bool(response.success), "message": response.message}
    print(json.dumps(told), flush=True)

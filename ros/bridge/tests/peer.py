"""A node of ROS 2 on `zenoh-ros2-sdk`, which is independent of DCA: sends each message that it hears back on another topic.

Arguments: the address and the port of the router. Standard input: a line of JSON for each topic, then the end. It answers with
a line for each topic, and a line `ready` when all of them are there.
"""

import json
import sys
import threading

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

address, port = sys.argv[1], int(sys.argv[2])
keep = []


def echo(topic: dict) -> None:
    shared = {
        "msg_type": topic["type"],
        "msg_definition": topic["definition"],
        "type_hash": topic["hash"],
        "domain_id": 7,
        "router_ip": address,
        "router_port": port,
        "qos": topic["qos"],
    }
    publisher = ROS2Publisher(topic=topic["back"], **shared)

    def back(message) -> None:
        names = [name for name in message.__dataclass_fields__ if name != "__msgtype__"]
        publisher.publish(**{name: getattr(message, name) for name in names})

    subscriber = ROS2Subscriber(topic=topic["there"], callback=back, **shared)
    keep.extend([publisher, subscriber])


ZenohSession.get_instance(address, port)
for line in sys.stdin:
    topic = json.loads(line)
    echo(topic)
    print(topic["type"], flush=True)
    if topic["last"]:
        break
print("ready", flush=True)
# Until the test takes the process away, or ends itself.
threading.Thread(target=sys.stdin.read).run()

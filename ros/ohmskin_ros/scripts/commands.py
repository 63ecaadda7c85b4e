#!/usr/bin/env python3
"""A node with services for skins on this computer: tare (std_srvs/Trigger) and set_mode (ohmskin_msgs/SetMode).

It needs `ohmskin.client` (pip install packaging/client), and runs as the user who runs `ohmskin live`.
"""

from contextlib import suppress

import rclpy
from ohmskin_msgs.srv import SetMode
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

from ohmskin.client import Commands
from ohmskin.client.remote import prefix
from ohmskin.errors import PublishError


def answered(response, command, *arguments):
    """The response, when a command is done or refused."""
    try:
        command(*arguments)
        response.success = True
    except PublishError as error:
        response.success, response.message = False, str(error)
    return response


def main():
    """Serve until the node is shut down."""
    rclpy.init()
    node = Node("ohmskin_commands")
    names = node.declare_parameter("skins", ["skin"]).value  # BODY.PATCH for patches of a body
    for name in names:
        commands = Commands(name)
        node.create_service(Trigger, f"{prefix(name)}/tare", lambda _, told, skin=commands: answered(told, skin.tare))
        node.create_service(
            SetMode,
            f"{prefix(name)}/set_mode",
            lambda asked, told, skin=commands: answered(told, skin.set_mode, asked.mode),
        )
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()

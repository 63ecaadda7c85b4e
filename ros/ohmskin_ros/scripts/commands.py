#!/usr/bin/env python3
"""A node with services for skins on this computer: tare (std_srvs/Trigger) and set_mode (ohmskin_msgs/SetMode).

It needs `ohmskin.client` (pip install packaging/client), and runs as the user who runs `ohmskin live`.
"""

import sys
from contextlib import suppress

import rclpy
from ohmskin_msgs.srv import SetMode
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
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


def serve(node, name):
    """Offer the services of a skin, in the node's namespace; they wait for one another, but for no other skin's."""
    commands, group, own = Commands(name), MutuallyExclusiveCallbackGroup(), prefix(name).removeprefix("/")
    node.create_service(
        Trigger,
        f"{own}/tare",
        lambda _, told: answered(told, commands.tare),
        callback_group=group,
    )
    node.create_service(
        SetMode,
        f"{own}/set_mode",
        lambda asked, told: answered(told, commands.set_mode, asked.mode),
        callback_group=group,
    )


def main():
    """Serve until the node is shut down."""
    rclpy.init()
    node = Node("ohmskin_commands")
    try:
        names = set(node.declare_parameter("skins", ["skin"]).value or ())  # BODY.PATCH for patches of a body
        if not names:
            raise PublishError("it is empty")
        for name in names:
            serve(node, name)
    except (ParameterException, PublishError) as error:
        sys.exit(f"the parameter `skins` must be a list of names of skins, such as ['skin']: {error}")
    executor = MultiThreadedExecutor(num_threads=len(names) + 1)  # even if all of them are silent
    executor.add_node(node)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()

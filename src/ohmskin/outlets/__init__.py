"""Outlets: shared memory, zenoh, DDS and Foxglove, through which other programs get contacts and images.

Its modules are imported one by one: the publishing process needs its own outlets only, and not the loop.
"""

"""Plays a folder that has left/ and right/ as a camera."""

import argparse
import itertools
import time
from pathlib import Path

from stereo_client import Client

arguments = argparse.ArgumentParser(description=__doc__)
arguments.add_argument("folder", type=Path)
arguments.add_argument("--server", default="zenoh://127.0.0.1:7447")
arguments.add_argument("--camera", default="front")
arguments.add_argument("--rate", type=float, default=10, help="frames a second")
arguments.add_argument("--repeat", action="store_true", help="start again at the end")
given = arguments.parse_args()

pairs = zip(sorted((given.folder / "left").iterdir()), sorted((given.folder / "right").iterdir()), strict=True)
with Client(given.server) as client, client.camera(given.camera) as camera:
    print(f"{camera.name} is served by {camera.wait_served()}")
    for left, right in itertools.cycle(pairs) if given.repeat else pairs:
        camera.publish(left, right)
        time.sleep(1 / given.rate)

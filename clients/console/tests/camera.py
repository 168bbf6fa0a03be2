"""A camera for the console's tests: puts the frames of some files in turn, ten a second, until it is ended.

python camera.py ENDPOINT NAME FILE..
"""

import itertools
import json
import sys
import time
from pathlib import Path

import zenoh

endpoint, name, *files = sys.argv[1:]
frames = [Path(file).read_bytes() for file in files]
config = zenoh.Config.from_json5(json.dumps({
    "mode": "client",
    "connect": {"endpoints": [endpoint]},
    "scouting": {"multicast": {"enabled": False}},
}))
with zenoh.open(config) as session:
    token = session.liveliness().declare_token(f"stereo/v1/camera/{name}")
    publisher = session.declare_publisher(
        f"stereo/v1/frames/{name}", encoding="application/protobuf;stereo.v1.StereoRequest"
    )
    print("up", flush=True)
    for frame in itertools.cycle(frames):
        publisher.put(frame)
        time.sleep(0.1)

"""The messages of the wire, made from the descriptor set that the package carries.

They live in a pool of their own, so that other generated code of the same package does not collide with them.
"""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory


def _load() -> descriptor_pool.DescriptorPool:
    data = files(__package__).joinpath("stereo.v1.binpb").read_bytes()
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        file.ClearField("source_code_info")
        pool.AddSerializedFile(file.SerializeToString())
    return pool


_POOL = _load()


def _message(name: str) -> Any:
    """Return the class of the message `stereo.v1.name`."""
    return message_factory.GetMessageClass(_POOL.FindMessageTypeByName(f"stereo.v1.{name}"))


class Enum:
    """An enum of the wire by its short names: `mono8` for `IMAGE_ENCODING_MONO8`."""

    def __init__(self, name: str, prefix: str) -> None:
        values = _POOL.FindEnumTypeByName(f"stereo.v1.{name}").values
        self.number = {value.name.removeprefix(prefix).lower(): value.number for value in values}
        self.name = {number: short for short, number in self.number.items()}


BatchReply = _message("BatchReply")
Calibration = _message("Calibration")
CameraSettings = _message("CameraSettings")
Image = _message("Image")
ImageStamp = _message("ImageStamp")
Options = _message("Options")
ServerLoad = _message("ServerLoad")
Status = _message("Status")
StereoRequest = _message("StereoRequest")
StereoResult = _message("StereoResult")

COMPRESSION = Enum("Compression", "COMPRESSION_")
DENSITY = Enum("Density", "DENSITY_")
DISPARITY_ENCODING = Enum("DisparityEncoding", "DISPARITY_ENCODING_")
IMAGE_ENCODING = Enum("ImageEncoding", "IMAGE_ENCODING_")
MESH_SPACE = Enum("MeshSpace", "MESH_SPACE_")
OUTPUT = Enum("Output", "OUTPUT_")
PAIRING_KEY = Enum("PairingKey", "PAIRING_KEY_")
PRESET = Enum("Preset", "PRESET_")
PRIORITY_CLASS = Enum("PriorityClass", "PRIORITY_CLASS_")
REASON = Enum("Reason", "REASON_")

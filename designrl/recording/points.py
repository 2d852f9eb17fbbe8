"""Points that any viewer of MCAP files draws."""

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud


def point_cloud(points: np.ndarray, colors: np.ndarray, now: int) -> PointCloud:
    """Points (n, 3) in m with colors (n, 3) in 0..255, in the frame `world`."""
    records = np.zeros(
        len(points), dtype=[("position", "<f4", 3), ("color", "u1", 3), ("alpha", "u1")]
    )
    records["position"], records["color"], records["alpha"] = points, colors, 255
    cloud = PointCloud(frame_id="world", point_stride=records.itemsize, data=records.tobytes())
    cloud.timestamp.FromNanoseconds(now)
    cloud.pose.orientation.w = 1.0
    for i, name in enumerate("xyz"):
        cloud.fields.add(name=name, offset=4 * i, type=PackedElementField.FLOAT32)
    for i, name in enumerate(("red", "green", "blue", "alpha")):
        cloud.fields.add(name=name, offset=12 + i, type=PackedElementField.UINT8)
    return cloud

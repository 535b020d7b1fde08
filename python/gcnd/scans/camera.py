"""A pinhole camera and where it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcnd.data.noise import FloatArray


@dataclass(frozen=True)
class Camera:
    """Maps directions to pixels: u = f x / z + c_x, v = f y / z + c_y, pixel centres at whole numbers.

    The camera's frame has x to the right, y down and z forward.

    Attributes:
        width: Columns.
        height: Rows.
        focal: Focal length f in pixels.
        center_x: c_x in pixels.
        center_y: c_y in pixels.
    """

    width: int
    height: int
    focal: float
    center_x: float
    center_y: float

    @classmethod
    def centered(cls, width: int, height: int, focal: float) -> Camera:
        """Makes a camera whose axis goes through the middle of the image."""
        return cls(width, height, focal, (width - 1) / 2, (height - 1) / 2)

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the columns and rows (…,) of points (…, 3) in the camera's frame, z > 0."""
        scale = self.focal / points[..., 2]
        return self.center_x + points[..., 0] * scale, self.center_y + points[..., 1] * scale

    def rays(self) -> FloatArray:
        """Returns the direction (height, width, 3) of every pixel, with z = 1."""
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = (np.arange(self.width) - self.center_x) / self.focal
        rays[..., 1] = (np.arange(self.height)[:, None] - self.center_y) / self.focal
        return rays

    def cropped(self, points: FloatArray, margin: int) -> Camera:
        """Returns the part of the image that holds the points and ``margin`` pixels around them.

        Its pixels are pixels of the whole image: only pixels without a point are left out. At least one pixel stays.

        Args:
            points: (N, 3) in the camera's frame, z > 0.
            margin: Pixels, >= 0.

        Example:
            >>> whole = Camera.centered(640, 480, 585.0)
            >>> part = whole.cropped(np.array([[0.0, 0, 1], [0.1, 0, 1]]), 2)
            >>> part.width, part.height, part.focal
            (64, 6, 585.0)
        """
        low, high = [], []
        for value, size in zip(self.project(points), (self.width, self.height), strict=True):
            first = min(max(int(np.floor(value.min())) - margin, 0), size - 1)
            low.append(first)
            high.append(min(max(int(np.ceil(value.max())) + margin, first), size - 1))
        return Camera(
            high[0] - low[0] + 1,
            high[1] - low[1] + 1,
            self.focal,
            self.center_x - low[0],
            self.center_y - low[1],
        )


@dataclass(frozen=True)
class Pose:
    """Where a camera stands.

    Attributes:
        world_from_camera: (3, 3) float64, a rotation: the columns are the camera's axes.
        position: (3,) float64, of the camera in the world.
    """

    world_from_camera: FloatArray
    position: FloatArray

    def to_camera(self, points: FloatArray) -> FloatArray:
        """Returns points (…, 3) of the world in the camera's frame."""
        local: FloatArray = (points - self.position) @ self.world_from_camera
        return local

    def to_world(self, points: FloatArray) -> FloatArray:
        """Returns points (…, 3) of the camera's frame in the world."""
        placed: FloatArray = points @ self.world_from_camera.T + self.position
        return placed

    def disturbed(self, rotation: FloatArray, translation: FloatArray, pivot: FloatArray) -> Pose:
        """Returns the pose turned around a point of the world and shifted.

        Args:
            rotation: (3,) axis times angle in radians.
            translation: (3,) in the unit of the world.
            pivot: (3,) in the world; stays where the rotation alone would leave it.
        """
        turn = rotation_from_vector(rotation)
        return Pose(turn @ self.world_from_camera, pivot + turn @ (self.position - pivot) + translation)


def look_at(target: FloatArray, direction: FloatArray, distance: float, roll: float) -> Pose:
    """Places a camera that looks at a point.

    Args:
        target: (3,) the point in the middle of the image.
        direction: (3,) of any length, from the target to the camera.
        distance: From the target to the camera.
        roll: Angle around the camera's axis, radians.

    Returns:
        The pose; at roll 0 the camera's y axis lies as near to the world's −z as it can (−y where it looks along z).

    Example:
        >>> pose = look_at(np.zeros(3), np.array([0.0, -2, 0]), 3.0, 0.0)
        >>> pose.position.tolist(), pose.to_camera(np.array([1.0, 0, 1])).round(9).tolist()
        ([0.0, -3.0, 0.0], [1.0, -1.0, 3.0])
    """
    outward = direction / np.linalg.norm(direction)
    forward = -outward
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    cos, sin = np.cos(roll), np.sin(roll)
    rolled = axes @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Pose(rolled, target + distance * outward)


def rotation_from_vector(vector: FloatArray) -> FloatArray:
    """Returns the rotation (3, 3) around a vector (3,) by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: FloatArray = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return turn


def random_direction(rng: np.random.Generator) -> FloatArray:
    """Returns a unit vector (3,), even over the sphere."""
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)

"""Row 8: calibrate cameras by pictures of a checkerboard, taken or rendered with known truth."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.plant.model import build_model
from minidual.plant.render import Image
from minidual.robot.pair import Array, Robot

CAMERAS = ("high", "left", "right")
INNER = (8, 5)
"""Inner corners of the board, along and across."""
SQUARE_M = 0.03
_CELL_PX = 40
_SIZE = (640, 480)
_TILTS_RAD = (
    (0.0, 0.0),
    (0.35, 0.0),
    (-0.35, 0.1),
    (0.0, 0.4),
    (0.1, -0.4),
    (0.3, 0.3),
    (-0.3, 0.3),
)
_LIKE = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Calibration:
    """Calibration of a camera by pictures of a board.

    Attributes:
        focal_px: At a picture height of 480.
        reprojection_px: RMS distance of the corners.
        pictures_n: In which the board was found.
    """

    focal_px: float
    reprojection_px: float
    pictures_n: int


def expected_focals(scene: SceneConfig, robot: Robot) -> dict[str, float]:
    """Return the focal length of each camera of the model, at a picture height of 480 [px]."""
    model = build_model(scene, robot, visuals=True)
    focals: dict[str, float] = {}
    for name in CAMERAS:
        fovy_rad = np.radians(float(model.camera(name).fovy[0]))
        focals[name] = 0.5 * _SIZE[1] / float(np.tan(0.5 * fovy_rad))
    return focals


def rendered_boards(focal_px: float) -> list[Image]:
    """Return pictures of the board from several sides, by a camera of a known focal length."""
    board = _board()
    height, width = board.shape
    matrix = _camera_matrix(focal_px)
    metres_per_px = SQUARE_M / _CELL_PX
    pictures: list[Image] = []
    for tilt_x, tilt_y in _TILTS_RAD:
        rotation, _ = cv2.Rodrigues(np.array([tilt_x, tilt_y, 0.05]))
        distance_m = 1.15 * focal_px * width * metres_per_px / _SIZE[0]
        shift = np.array([0.0, 0.0, distance_m])
        to_metres = np.array(
            [
                [metres_per_px, 0.0, -0.5 * width * metres_per_px],
                [0.0, metres_per_px, -0.5 * height * metres_per_px],
                [0.0, 0.0, 1.0],
            ],
        )
        plane = np.column_stack([rotation[:, 0], rotation[:, 1], shift])
        homography = matrix @ plane @ to_metres
        drawn = cv2.warpPerspective(
            board,
            homography,
            _SIZE,
            flags=cv2.INTER_AREA,
            borderValue=(255,),
        )
        pictures.append(np.asarray(drawn, np.uint8))
    return pictures


def _board() -> Array:
    """Return the board as a picture: squares with a white rim."""
    columns = INNER[0] + 1
    rows = INNER[1] + 1
    squares = (np.indices((rows, columns)).sum(axis=0) % 2) * 255
    cells = np.kron(squares, np.ones((_CELL_PX, _CELL_PX))).astype(np.uint8)
    return np.pad(cells, _CELL_PX, constant_values=255)


def _camera_matrix(focal_px: float) -> Array:
    return np.array(
        [[focal_px, 0.0, 0.5 * _SIZE[0]], [0.0, focal_px, 0.5 * _SIZE[1]], [0.0, 0.0, 1.0]],
    )


def calibrate(pictures: list[Image]) -> Calibration:
    """Calibrate by pictures of one size; NaN if the board is found in fewer than three."""
    grid = np.zeros((INNER[0] * INNER[1], 3), np.float32)
    grid[:, :2] = np.mgrid[0 : INNER[0], 0 : INNER[1]].T.reshape(-1, 2) * SQUARE_M
    boards: list[NDArray[np.float32]] = []
    for picture in pictures:
        complete, corners = cv2.findChessboardCornersSB(picture, INNER)
        if complete:
            boards.append(np.asarray(corners, np.float32))
    if len(boards) < 3:
        return Calibration(float("nan"), float("nan"), len(boards))
    height, width = pictures[0].shape[:2]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    start = _camera_matrix(float(width))
    start[0, 2] = 0.5 * width
    start[1, 2] = 0.5 * height
    error_px, matrix, *_ = cv2.calibrateCamera(
        [grid] * len(boards),
        boards,
        (width, height),
        start,
        np.zeros(5),
        flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
    )
    return Calibration(float(matrix[1, 1]) * _SIZE[1] / height, float(error_px), len(boards))


def taken_boards(folder: Path, camera: str) -> list[Image]:
    """Return the pictures in FOLDER/CAMERA, grey.

    Raises:
        UsageError: There is no such folder, or no picture in it.
    """
    place = folder / camera
    names = sorted(path for path in place.glob("*") if path.suffix.lower() in _LIKE)
    if not names:
        raise UsageError(
            f"--boards: there are no pictures in {place}",
            remedy=f"put PNG or JPEG pictures of a checkerboard with {INNER[0]} by {INNER[1]} inner "
            f"corners and {SQUARE_M:g} m squares into {', '.join(CAMERAS)}",
        )
    pictures = [cv2.imread(str(name), cv2.IMREAD_GRAYSCALE) for name in names]
    return [np.asarray(picture, np.uint8) for picture in pictures if picture is not None]

"""Worlds of boxes, upright cylinders and spheres on the ground, and rays cast into them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
STATIC, MOVING, FOLIAGE = 0, 1, 2
"""Labels of what a ray meets."""
_AWAY = 1e9
"""m: nothing was met."""
_STILL = np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What stands in the world; every length in m."""

    boxes: Array
    """Lowest and highest corner, shape (n, 6). The first is met from its inside if `is_room`."""
    is_room: bool = False
    cylinders: Array = field(default_factory=lambda: np.empty((0, 5)))
    """x, y of the axis, radius, lowest and highest z, shape (n, 5)."""
    spheres: Array = field(default_factory=lambda: np.empty((0, 4)))
    """Centre and radius, shape (n, 4): foliage, met somewhere within."""
    movers: Array = field(default_factory=lambda: np.empty((0, 9)))
    """Boxes that move: lowest and highest corner at t = 0, velocity, shape (n, 9)."""
    has_ground: bool = True
    """The plane z = 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What rays meet."""

    distance: Array
    """m, shape (n,); 1e9 where nothing was met."""
    cosine: Array
    """Of the angle of incidence, shape (n,)."""
    label: npt.NDArray[np.uint8]
    velocity: Array
    """m/s, of what is met, shape (n, 3)."""


def cast(world: World, origin: Array, direction: Array, t: Array) -> Hits:
    """Return what each ray meets first.

    Args:
        world: The world.
        origin: m, shape (n, 3).
        direction: Unit vectors, shape (n, 3).
        t: s, of each ray, shape (n,): where the movers are.
    """
    count = len(origin)
    best = np.full(count, _AWAY)
    cosine = np.ones(count)
    label = np.zeros(count, np.uint8)
    velocity = np.zeros((count, 3))
    safe = np.where(np.abs(direction) < 1e-12, 1e-12, direction)

    def take(distance: Array, incidence: Array, kind: int, speed: Array = _STILL) -> None:
        nearer = (distance > 1e-3) & (distance < best)
        best[nearer] = distance[nearer]
        cosine[nearer] = incidence[nearer]
        label[nearer] = kind
        velocity[nearer] = speed

    if world.has_ground:
        take(-origin[:, 2] / safe[:, 2], np.abs(direction[:, 2]), STATIC)
    for number, box in enumerate(world.boxes):
        inside = world.is_room and number == 0
        take(*_box(origin, safe, box[:3], box[3:], inside), STATIC)
    for box in world.movers:
        place = box[6:9] * t[:, None]
        take(*_box(origin - place, safe, box[:3], box[3:6], False), MOVING, box[6:9])
    for axis in world.cylinders:
        take(*_cylinder(origin, safe, axis), STATIC)
    for ball in world.spheres:
        take(*_sphere(origin, direction, ball), FOLIAGE)
    return Hits(best, cosine, label, velocity)


def _box(
    origin: Array, direction: Array, low: Array, high: Array, inside: bool
) -> tuple[Array, Array]:
    to_low, to_high = (low - origin) / direction, (high - origin) / direction
    near, far = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
    enter, leave = near.max(axis=1), far.min(axis=1)
    if inside:
        axis, distance = far.argmin(axis=1), leave
    else:
        axis = near.argmax(axis=1)
        distance = np.where((enter <= leave) & (enter > 0), enter, _AWAY)
    return distance, np.abs(np.take_along_axis(direction, axis[:, None], 1)[:, 0])


def _cylinder(origin: Array, direction: Array, axis: Array) -> tuple[Array, Array]:
    x, y = origin[:, 0] - axis[0], origin[:, 1] - axis[1]
    u, v = direction[:, 0], direction[:, 1]
    a, b = u * u + v * v, x * u + y * v
    root = b * b - a * (x * x + y * y - axis[2] ** 2)
    distance = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, _AWAY)
    z = origin[:, 2] + distance * direction[:, 2]
    distance = np.where((distance > 0) & (z > axis[3]) & (z < axis[4]), distance, _AWAY)
    normal = ((x + distance * u) * u + (y + distance * v) * v) / axis[2]
    return distance, np.minimum(np.abs(normal), 1.0)


def _sphere(origin: Array, direction: Array, ball: Array) -> tuple[Array, Array]:
    to = origin - ball[:3]
    b = (to * direction).sum(axis=1)
    root = b * b - (to * to).sum(axis=1) + ball[3] ** 2
    half = np.sqrt(np.maximum(root, 0.0))
    # A leaf somewhere within: the same for the same ray, without a generator
    share = np.modf(np.abs(np.sin(direction @ (127.1, 311.7, 74.7)) * 43758.5453))[0]
    distance = np.where(root > 0, -b - half + 2.0 * half * share, _AWAY)
    return np.where(distance > 0, distance, _AWAY), np.ones(len(origin))


def _boxes(*rows: tuple[float, ...]) -> Array:
    return np.array(rows, np.float64)


def _standing(x: Array, y: Array, half: Array, height: Array) -> Array:
    """Return boxes that stand on the ground, from their centres."""
    low = np.stack((x - half[:, 0], y - half[:, 1], np.zeros(len(x))), -1)
    return np.concatenate((low, np.stack((x + half[:, 0], y + half[:, 1], height), -1)), -1)


def room(rng: np.random.Generator) -> World:
    """Return a room of 9 by 7 by 2.8 m with furniture and a door left open."""
    count = 12
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    furniture = _standing(
        3.9 * np.cos(angle),
        2.9 * np.sin(angle),
        rng.uniform(0.15, 0.5, (count, 2)),
        rng.uniform(0.4, 2.0, count),
    )
    shell = _boxes((-4.5, -3.5, 0.0, 4.5, 3.5, 2.8))
    lamp = _boxes((-0.6, -0.2, 2.2, 0.6, 0.2, 2.3), (4.4, -0.5, 0.0, 4.5, 0.5, 2.1))
    return World(np.concatenate((shell, furniture, lamp)), is_room=True)


def street(rng: np.random.Generator) -> World:
    """Return a street of 260 m between houses, with posts, parked cars, and traffic."""
    x = np.arange(-30.0, 230.0, 13.0)
    houses = []
    for side in (-1, 1):
        depth = rng.uniform(9.0, 12.0, len(x))
        half = np.stack((rng.uniform(4.5, 6.3, len(x)), np.full(len(x), 4.0)), -1)
        houses.append(_standing(x, side * (depth + 4.0), half, rng.uniform(6.0, 18.0, len(x))))
    parked = rng.uniform(-20, 220, 24)
    cars = _standing(
        parked,
        np.where(rng.random(24) < 0.5, -5.5, 5.5),
        np.tile((2.2, 0.9), (24, 1)),
        rng.uniform(1.4, 2.0, 24),
    )
    posts = np.stack(
        (x, np.where(np.arange(len(x)) % 2, 7.2, -7.2), *np.tile([[0.12], [0], [7]], len(x))), -1
    )
    start, speed = rng.uniform(0, 220, 8), rng.uniform(-10, 10, 8)
    lane = np.where(speed > 0, -2.4, 2.4)
    traffic = _standing(start, lane, np.tile((2.2, 0.9), (8, 1)), np.full(8, 1.6))
    velocity = np.stack((speed, np.zeros(8), np.zeros(8)), -1)
    return World(
        np.concatenate((*houses, cars)),
        cylinders=posts,
        movers=np.concatenate((traffic, velocity), -1),
    )


def forest(rng: np.random.Generator) -> World:
    """Return trees with crowns on level ground, none within 3 m of the way."""
    place = rng.uniform(-55, 55, (400, 2))
    away = np.abs(np.hypot(*place.T) - 20.0) > 3.0
    place = place[away][:150]
    radius = rng.uniform(0.1, 0.35, len(place))
    height = rng.uniform(6, 14, len(place))
    trunks = np.column_stack((place, radius, np.zeros(len(place)), height))
    crowns = np.column_stack((place, height, rng.uniform(1.2, 2.8, len(place))))
    x, y = rng.uniform(-40, 40, (2, 12))
    logs = _standing(x, y, rng.uniform(0.3, 1.5, (12, 2)), rng.uniform(0.3, 0.8, 12))
    return World(logs, cylinders=trunks, spheres=crowns)


def tunnel(rng: np.random.Generator) -> World:
    """Return 90 m of bare tunnel, x = 10 to 100 m, between two halls with things in them."""
    walls = _boxes(
        (10, 3, 0, 100, 15, 5),
        (10, -15, 0, 100, -3, 5),
        (-15, -15, 5, 125, 15, 6),
        (-16, -15, 0, -15, 15, 5),
        (125, -15, 0, 126, 15, 5),
        (-15, 15, 0, 125, 16, 5),
        (-15, -16, 0, 125, -15, 5),
    )
    things = [
        _standing(
            rng.uniform(*hall, 10),
            rng.choice((-1, 1), 10) * rng.uniform(4, 13, 10),
            rng.uniform(0.3, 1.2, (10, 2)),
            rng.uniform(0.5, 4.0, 10),
        )
        for hall in ((-13, 8), (102, 123))
    ]
    return World(np.concatenate((walls, *things)))


def plain(rng: np.random.Generator) -> World:
    """Return bare ground with a few things far away."""
    angle, reach = rng.uniform(0, 2 * np.pi, 6), rng.uniform(60, 90, 6)
    return World(
        _standing(
            reach * np.cos(angle),
            reach * np.sin(angle),
            rng.uniform(1, 4, (6, 2)),
            rng.uniform(2, 7, 6),
        )
    )


def hall(rng: np.random.Generator) -> World:
    """Return a hall of 80 by 60 m, 22 m high, with containers at its walls."""
    count = 16
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    containers = _standing(
        33.0 * np.cos(angle),
        24.0 * np.sin(angle),
        rng.uniform(1.2, 4.0, (count, 2)),
        rng.uniform(2.5, 14.0, count),
    )
    shell = _boxes((-40.0, -30.0, 0.0, 40.0, 30.0, 22.0))
    return World(np.concatenate((shell, containers)), is_room=True)


WORLDS: dict[str, Callable[[np.random.Generator], World]] = {
    "room": room,
    "street": street,
    "forest": forest,
    "tunnel": tunnel,
    "plain": plain,
    "hall": hall,
}

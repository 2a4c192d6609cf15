"""The scenes: bodies in an object frame whose origin lies on or in the object, z towards the viewer, y up.

`build(name, seed)` varies sizes, places and paint with the seed; seed 0 is the nominal scene. All lengths in metres;
the
objects fit into about 0.5 x 0.4 x 0.3 m, what lies behind them is a wall of 2.4 m.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sl_common import transforms
from sl_common.errors import StructuredLightError
from sl_sim import isosurface, meshes
from sl_sim.meshes import Mesh
from sl_sim.raycast import Body

WALL = 2.4


class UnknownSceneError(StructuredLightError):
    """No scene of that name."""


@dataclass(frozen=True)
class Scene:
    """Named bodies in the object frame; `followed` tells which of them move when the object moves (all but the
    wall).
    """

    name: str
    description: str
    parts: tuple[tuple[Mesh, np.ndarray], ...]
    followed: tuple[bool, ...]

    def bodies(self, base_from_object: np.ndarray, *, moving: bool = False) -> list[Body]:
        """The parts placed in the base frame. With moving=True the followed parts may be moved, as one body."""
        fixed, joined = [], []
        for (mesh, object_from_part), follows in zip(self.parts, self.followed, strict=True):
            if moving and follows:
                joined.append(mesh.moved(object_from_part))
            else:
                fixed.append(Body(mesh, base_from_object @ object_from_part))
        if joined:
            fixed.append(Body(meshes.join(joined, self.name), np.array(base_from_object), moving=True))
        return fixed


def _pose(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    return transforms.make(transforms.rotation_exp(np.asarray(turn, float)), np.array([x, y, z]))


def _somewhere(rng: np.random.Generator, lower: tuple[float, ...], upper: tuple[float, ...]) -> np.ndarray:
    return transforms.make(transforms.rotation_exp(rng.uniform(-1, 1, 3)), rng.uniform(lower, upper))


def _wall(distance: float, rng: np.random.Generator, *, grey: float = 0.75) -> tuple[Mesh, np.ndarray]:
    tint = grey * (1.0 + 0.04 * rng.standard_normal(3))
    return meshes.rectangle(WALL, WALL, albedo=tuple(tint), name="wall"), _pose(z=-distance)


def _paint(rng: np.random.Generator, level: float = 0.72, spread: float = 0.06) -> tuple[float, float, float]:
    return tuple(np.clip(level * (1.0 + spread * rng.standard_normal(3)), 0.1, 0.9))


def _harmonics(rng: np.random.Generator, count: int, wavelength: tuple[float, float]) -> np.ndarray:
    """(count, 4): wave vector x, y [1/m], phase, relative amplitude."""
    length = rng.uniform(*wavelength, count)
    angle = rng.uniform(0, np.pi, count)
    wave = 2 * np.pi / length
    return np.stack(
        [wave * np.cos(angle), wave * np.sin(angle), rng.uniform(0, 2 * np.pi, count), rng.uniform(0.5, 1, count)], 1
    )


def _sum(waves: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    phase = x[..., None] * waves[:, 0] + y[..., None] * waves[:, 1] + waves[:, 2]
    return (np.sin(phase) * waves[:, 3]).sum(-1) / waves[:, 3].sum()


def _spherical_waves(rng: np.random.Generator, count: int, number: tuple[float, float]) -> np.ndarray:
    """(count, 4): wave vector on the unit sphere and phase."""
    axes = rng.standard_normal((count, 3))
    axes *= rng.uniform(*number, (count, 1)) / np.linalg.norm(axes, axis=1, keepdims=True)
    return np.concatenate([axes, rng.uniform(0, 2 * np.pi, (count, 1))], axis=1)


def _bumps(waves: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return np.sin(direction @ waves[:, :3].T + waves[:, 3]).sum(1)


Parts = list[tuple[Mesh, np.ndarray]]


def _plane(rng: np.random.Generator) -> Parts:
    """flat wall square to the viewer"""
    return [_wall(0.0, rng)]


def _tilted(rng: np.random.Generator) -> Parts:
    """flat board turned 35 to 50 degrees"""
    mesh, _ = _wall(0.0, rng)
    angle, about = np.radians(rng.uniform(35, 50)), rng.uniform(0, 2 * np.pi)
    return [(mesh, _pose(turn=(angle * np.cos(about), angle * np.sin(about), 0.0)))]


def _sphere(rng: np.random.Generator) -> Parts:
    """ball before a wall"""
    radius = rng.uniform(0.12, 0.16)
    return [_wall(0.12, rng), (meshes.sphere(radius, albedo=_paint(rng)), _pose(z=radius * 0.2))]


def _wavy(rng: np.random.Generator) -> Parts:
    """smooth wavy surface"""
    waves = _harmonics(rng, 7, (0.18, 0.5))
    mesh = meshes.height_field(
        lambda x, y: 0.055 * _sum(waves, x, y), 1.4, 1.4, step=0.004, albedo=_paint(rng), name="waves"
    )
    return [(mesh, _pose())]


def _bust(rng: np.random.Generator) -> Parts:
    """head and shoulders blended from ellipsoids, before a wall"""
    vary = lambda value: value * (1.0 + 0.05 * rng.standard_normal())  # noqa: E731
    # centre x y z, semi-axes x y z, in a frame whose origin lies in the neck
    blobs = np.array(
        [
            [0.0, vary(0.115), 0.01, vary(0.075), vary(0.105), vary(0.088)],  # skull
            [0.0, vary(0.055), 0.035, vary(0.052), vary(0.05), vary(0.052)],  # jaw
            [0.0, 0.0, -0.01, vary(0.05), 0.09, 0.052],  # neck
            [0.0, -0.115, -0.02, vary(0.175), vary(0.062), 0.075],  # shoulders
            [0.0, -0.165, 0.0, vary(0.14), 0.07, 0.09],  # chest
            [0.0, vary(0.088), 0.098, 0.016, 0.03, 0.022],  # nose
            [0.0, 0.138, 0.072, 0.05, 0.017, 0.026],  # brow
        ]
    )
    eyes = np.array([[0.033, 0.108, 0.093, 0.021], [-0.033, 0.108, 0.093, 0.021]])

    def field(points: np.ndarray) -> np.ndarray:
        scaled = (points[:, None, :] - blobs[None, :, :3]) / blobs[None, :, 3:]
        solid = np.exp(4.0 * (1.0 - (scaled**2).sum(-1))).sum(-1)
        sockets = np.exp(-(((points[:, None, :] - eyes[None, :, :3]) / eyes[None, :, 3:]) ** 2).sum(-1)).sum(-1)
        return np.log(solid + 1e-9) - 0.9 * sockets

    mesh = isosurface.mesh(
        field, (-0.25, -0.27, -0.14), (0.25, 0.27, 0.16), step=0.0045, albedo=_paint(rng, 0.7, 0.04), name="bust"
    )
    turn = (0.06 * rng.standard_normal(), 0.25 * rng.standard_normal(), 0.05 * rng.standard_normal())
    return [_wall(0.16, rng), (mesh, _pose(y=-0.03, turn=turn))]


def _boxes(rng: np.random.Generator) -> Parts:
    """several boxes before a wall"""
    parts = [_wall(0.14, rng)]
    places = [(-0.14, -0.08), (0.02, 0.05), (0.16, -0.05), (-0.10, 0.13), (0.17, 0.13)]
    for x, y in places:
        size = tuple(rng.uniform((0.10, 0.10, 0.06), (0.19, 0.17, 0.20)))
        turn = tuple(rng.uniform(-0.45, 0.45, 3))
        at = _pose(x + 0.02 * rng.standard_normal(), y + 0.02 * rng.standard_normal(), rng.uniform(-0.08, 0.0), turn)
        parts.append((meshes.box(size, albedo=_paint(rng, rng.uniform(0.45, 0.85), 0.12)), at))
    return parts


def _stairs(rng: np.random.Generator) -> Parts:
    """stairs: a staircase of depth edges"""
    steps, rise, tread = 6, rng.uniform(0.018, 0.035), rng.uniform(0.055, 0.08)
    parts = []
    for k in range(steps):
        size = (0.7, tread, 0.3 + rise * k)
        parts.append(
            (
                meshes.box(size, albedo=_paint(rng), name=f"step {k}"),
                _pose(y=(k - steps / 2 + 0.5) * tread, z=rise * k / 2 - 0.2),
            )
        )
    spin = _pose(turn=(0.0, 0.0, rng.uniform(-np.pi, np.pi)))
    return [_wall(0.12, rng)] + [(mesh, spin @ pose) for mesh, pose in parts]


def _corner(rng: np.random.Generator) -> Parts:
    """inner corner of three walls, light walls that light each other"""
    side = 0.9
    paint = [_paint(rng, 0.85, 0.03) for _ in range(3)]
    faces = [np.eye(4), _pose(turn=(0.0, np.pi / 2, 0.0)), _pose(turn=(-np.pi / 2, 0.0, 0.0))]
    shift = [(side / 2, side / 2, 0.0), (0.0, side / 2, side / 2), (side / 2, 0.0, side / 2)]
    tilt = transforms.rotation_exp(np.array([0.0, -np.pi / 4, 0.0]))
    tilt = transforms.rotation_exp(np.array([np.arctan(1 / np.sqrt(2)), 0.0, 0.0])) @ tilt
    room = transforms.make(
        transforms.rotation_exp(np.array([*(0.15 * rng.standard_normal(2)), rng.uniform(-0.5, 0.5)])) @ tilt,
        [0, -0.03, -0.1],
    )
    return [
        (meshes.rectangle(side, side, albedo=paint[k], name="corner"), room @ _pose(*shift[k]) @ faces[k])
        for k in range(3)
    ]


def _cylinder(rng: np.random.Generator) -> Parts:
    """leaning cylinder before a wall"""
    radius = rng.uniform(0.09, 0.15)
    lean = _pose(z=0.02, turn=tuple(rng.uniform(-0.3, 0.3, 3)))
    return [_wall(radius * 0.9 + 0.03, rng), (meshes.cylinder(radius, 0.45, albedo=_paint(rng)), lean)]


def _textured(rng: np.random.Generator) -> Parts:
    """wavy surface with stained, weakly coloured paint"""
    shape, stains = _harmonics(rng, 6, (0.2, 0.5)), [_harmonics(rng, 12, (0.02, 0.15)) for _ in range(3)]
    mesh = meshes.height_field(lambda x, y: 0.035 * _sum(shape, x, y), 1.2, 1.2, step=0.003, name="stained")

    def colour(at: np.ndarray) -> np.ndarray:
        tone = np.stack([_sum(s, at[:, 0], at[:, 1]) for s in stains], -1)
        return 0.55 * (1.0 + 0.9 * tone.mean(-1, keepdims=True)) * (1.0 + 0.35 * (tone - tone.mean(-1, keepdims=True)))

    return [(mesh.painted(colour), _pose())]


def _checker(rng: np.random.Generator) -> Parts:
    """flat board printed with squares of eight to one in reflectance"""
    square, angle = rng.uniform(0.03, 0.06), rng.uniform(0, np.pi)
    mesh = meshes.height_field(lambda x, y: 0 * x, 0.9, 0.9, step=0.0016, name="checkerboard")

    def colour(at: np.ndarray) -> np.ndarray:
        x = at[:, 0] * np.cos(angle) + at[:, 1] * np.sin(angle)
        y = at[:, 1] * np.cos(angle) - at[:, 0] * np.sin(angle)
        dark = (np.floor(x / square) + np.floor(y / square)) % 2 > 0
        return np.where(dark, 0.1, 0.8)[:, None]

    tilt = tuple(rng.uniform(-0.4, 0.4, 2))
    return [_wall(0.3, rng), (mesh.painted(colour), _pose(turn=(*tilt, 0.0)))]


def _glossy(rng: np.random.Generator) -> Parts:
    """glossy blob before a wall"""
    waves = _spherical_waves(rng, 5, (2, 4))

    def radius(direction: np.ndarray) -> np.ndarray:
        return 0.13 * (1.0 + 0.05 * _bumps(waves, direction))

    mesh = replace(
        meshes.star_shape(radius, albedo=_paint(rng, 0.6, 0.1), name="glazed"), gloss=0.12, gloss_exponent=60.0
    )
    return [_wall(0.11, rng), (mesh, _pose(z=0.03))]


def _clutter(rng: np.random.Generator) -> Parts:
    """balls, boxes and a cylinder in a heap before a wall"""
    parts = [_wall(0.15, rng)]
    for _ in range(4):
        at = _somewhere(rng, (-0.2, -0.15, -0.1), (0.2, 0.15, 0.06))
        parts.append(
            (
                meshes.sphere(rng.uniform(0.03, 0.08), parallels=160, albedo=_paint(rng, rng.uniform(0.4, 0.85), 0.15)),
                at,
            )
        )
    for _ in range(5):
        at = _somewhere(rng, (-0.22, -0.17, -0.12), (0.22, 0.17, 0.04))
        size = tuple(rng.uniform(0.05, 0.16, 3))
        parts.append((meshes.box(size, albedo=_paint(rng, rng.uniform(0.4, 0.85), 0.15)), at))
    at = _somewhere(rng, (-0.1, -0.1, -0.05), (0.1, 0.1, 0.05))
    parts.append((meshes.cylinder(0.04, 0.3, albedo=_paint(rng)), at))
    return parts


def _freeform(rng: np.random.Generator) -> Parts:
    """lumpy body with hollows before a wall"""
    waves = _spherical_waves(rng, 9, (3, 9))

    def radius(direction: np.ndarray) -> np.ndarray:
        return 0.14 * (1.0 + 0.05 * _bumps(waves, direction))

    return [_wall(0.12, rng), (meshes.star_shape(radius, albedo=_paint(rng, 0.7, 0.08), name="lump"), _pose(z=0.02))]


_BUILDERS: dict[str, Callable[[np.random.Generator], Parts]] = {
    "plane": _plane,
    "tilted": _tilted,
    "sphere": _sphere,
    "wavy": _wavy,
    "bust": _bust,
    "boxes": _boxes,
    "stairs": _stairs,
    "corner": _corner,
    "cylinder": _cylinder,
    "textured": _textured,
    "checker": _checker,
    "glossy": _glossy,
    "clutter": _clutter,
    "freeform": _freeform,
}

NAMES = tuple(_BUILDERS)


def check(name: str) -> None:
    """Raise UnknownSceneError, with the list of names, when there is no such scene."""
    if name not in _BUILDERS:
        raise UnknownSceneError(f"unknown scene '{name}': use one of {', '.join(NAMES)}")


def describe(name: str) -> str:
    """What a scene shows, in a few words."""
    check(name)
    return (_BUILDERS[name].__doc__ or name).strip()


def build(name: str, seed: int = 0) -> Scene:
    """The scene of this name, varied by the seed. Raises UnknownSceneError with the list of names."""
    check(name)
    parts = _BUILDERS[name](np.random.default_rng([seed, *name.encode()]))
    followed = tuple(mesh.name != "wall" or len(parts) == 1 for mesh, _ in parts)
    return Scene(name, describe(name), tuple(parts), followed)

"""Marks of a picture: parcels, supports, zone, modules, goals, exits and queue.

A parcel without a colour is grey, and an arrow shows its heading. A parcel of a stream has the
colour of its exit or group. It is drawn in a faster way, because a stream has many parcels.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pygame

from surface_gym.physics.types import Array
from surface_gym.rendering import ink, scene as scenes
from surface_gym.rendering.scene import PixelLayout, Pose, Scene, SceneParcel, StopLine

_FINE_STEP, _COARSE_STEP = 3.0, 7.0  # [px] between the points of a fading and of a coloured trail
_TRAIL_PIECE = 8  # points with one opacity
_OPACITY = 0.55  # of a coloured base, so that modules below it stay visible
_NEAR = 0.01  # [m] points up to this much farther than the closest one count as touching
_SPIKES = 8
_FRONT = 0.32  # length of the front triangle divided by the front's distance from the centre
_ROOM = 1.2  # maximum width of a label divided by the smallest distance from the centre to a corner


def centroid(outline: Array) -> Array:
    """Compute the centre (2,) [m] of the area within an outline."""
    start = outline - outline[0]
    end = np.roll(start, -1, axis=0)
    area = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    return outline[0] + area @ (start + end) / (3.0 * area.sum())


def placed(points: Array, pose: Pose) -> Array:
    """Transform points (..., 2) [m] from the frame of a base at `pose` to the surface."""
    x, y, theta = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])


def draw_trail(canvas: pygame.Surface, layout: PixelLayout, parcel: SceneParcel) -> None:
    """Draw the recent path of a parcel's centre. Its older part is fainter or thinner."""
    if len(parcel.trail) < 2:
        return
    index = parcel.colour_index
    if index is None:
        points = ink.thinned(layout.pixels(parcel.trail), _FINE_STEP)
        for first in range(0, len(points) - 1, _TRAIL_PIECE):
            piece = points[first : first + _TRAIL_PIECE + 1]
            age = 1.0 - first / len(points)
            ink.line(canvas, piece, 2.2 * layout.stroke, ink.PAPER, 0.6)
            ink.line(canvas, piece, layout.stroke, ink.INK, 1.0 - 0.6 * age)
        return
    points = ink.thinned(layout.pixels(parcel.trail), _COARSE_STEP)
    colour = ink.exit_colour(index)
    wide = max(2, round(0.25 * layout.cell))
    ends = np.linspace(0, len(points) - 1, wide + 1).astype(np.int64).tolist()
    for width, (first, last) in enumerate(pairwise(ends), start=1):
        piece = points[first : last + 1]
        ink.stroke(canvas, piece, width + 2, ink.mixed(colour, ink.INK, 0.75))
        ink.stroke(canvas, piece, width, colour)


def draw_parcel(
    canvas: pygame.Surface, layout: PixelLayout, scene: Scene, parcel: SceneParcel
) -> None:
    """Draw a parcel with colour and label, or in grey with an arrow if it has no colour index."""
    corners = layout.pixels(placed(parcel.outline, parcel.pose))
    index = parcel.colour_index
    if index is None:
        ink.polygon(canvas, corners, ink.PARCEL, 0.45)
        ink.outline(canvas, corners, layout.stroke, ink.INK)
        draw_heading(canvas, layout, parcel.outline, parcel.pose, ink.INK)
        return
    colour = ink.exit_colour(index)
    rim = max(1, round(0.22 * layout.cell))
    inside = ink.inset(corners, 0.5 * rim + 0.5)
    ink.wash(canvas, inside, colour, _OPACITY)
    ink.border(canvas, inside, rim + 1, colour)
    ink.border(canvas, corners, max(1, round(0.13 * layout.cell)), ink.INK)
    if parcel.wrong:
        ink.border(canvas, corners, max(2, round(0.3 * layout.cell)), ink.GOAL)
    _draw_front(canvas, layout, parcel, ink.text_on(colour))
    own = "" if parcel.exit is None else scene.exits[parcel.exit].name
    _draw_label(canvas, layout, parcel, parcel.label or own, colour)


def draw_heading(
    canvas: pygame.Surface, layout: PixelLayout, outline: Array, pose: Pose, colour: ink.Colour
) -> None:
    """Draw an arrow from the centre of a base along the x axis of its frame.

    `outline` (points, 2) [m] is the base in its own frame, and `pose` is the pose of this frame.
    """
    centre = centroid(outline)
    nose = centre + np.array([0.72 * (outline[:, 0].max() - centre[0]), 0.0])
    tail, tip = layout.pixels(placed(np.array([centre, nose]), pose))
    halo = np.array([tail, tail + 0.9 * (tip - tail)])
    ink.line(canvas, halo, 3.0 * layout.stroke, ink.PAPER, 0.6)
    ink.arrow(canvas, tail, tip, 1.3 * layout.stroke, colour)
    ink.disc(canvas, tail, 1.7 * layout.stroke, colour)


def draw_sensed(canvas: pygame.Surface, layout: PixelLayout, parcel: SceneParcel) -> None:
    """Draw the outline of the base at the sensed pose. Without a sensed pose, draw nothing."""
    if parcel.sensed_pose is not None:
        corners = layout.pixels(placed(parcel.outline, parcel.sensed_pose))
        width = max(1, round(0.1 * layout.cell))
        ink.dashed_border(canvas, corners, width, ink.SENSED, max(6.0, 0.6 * layout.cell))


def draw_touch(
    canvas: pygame.Surface, layout: PixelLayout, first: SceneParcel, second: SceneParcel
) -> None:
    """Draw a flash where two parcels touch."""
    x, y = layout.pixels(contact_point(first, second)).tolist()
    flash = _flash(max(9, round(0.85 * layout.cell)))
    canvas.blit(flash, flash.get_rect(center=(round(x), round(y))))


def contact_point(first: SceneParcel, second: SceneParcel) -> Array:
    """Compute the middle (2,) [m] of the region where two bases are closest."""
    one, other = placed(first.outline, first.pose), placed(second.outline, second.pose)
    distances, middles = [], []
    for points, corners in ((one, other), (other, one)):
        along = np.roll(corners, -1, axis=0) - corners
        away = points[:, np.newaxis] - corners  # (points, edges, 2)
        length = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
        share = np.clip((away * along).sum(axis=-1) / length, 0.0, 1.0)
        foot = corners + share[..., np.newaxis] * along
        nearest = points[:, np.newaxis] - foot
        distances.append(np.hypot(nearest[..., 0], nearest[..., 1]).ravel())
        middles.append((foot + 0.5 * nearest).reshape(-1, 2))
    distance, middle = np.concatenate(distances), np.concatenate(middles)
    near = middle[distance <= distance.min() + _NEAR]
    return 0.5 * (near.min(axis=0) + near.max(axis=0))


def _draw_front(
    canvas: pygame.Surface, layout: PixelLayout, parcel: SceneParcel, colour: ink.Colour
) -> None:
    """Draw a triangle at a base's front. The triangle points along x of the base's frame."""
    centre, front = centroid(parcel.outline), parcel.outline[:, 0].max()
    reach = front - centre[0]
    tip = np.array([centre[0] + 0.88 * reach, centre[1]])
    corners = tip + _FRONT * reach * np.array([[-1.0, 0.7], [0.0, 0.0], [-1.0, -0.7]])
    ink.polygon(canvas, layout.pixels(placed(corners, parcel.pose)), colour)


def _draw_label(
    canvas: pygame.Surface, layout: PixelLayout, parcel: SceneParcel, text: str, colour: ink.Colour
) -> None:
    """Draw a label in the middle of a base, if the label fits into the base."""
    size, centre = layout.label_size, centroid(parcel.outline)
    clear = float(np.hypot(*(parcel.outline - centre).T).min())
    if text and ink.badge_width(text, size) <= _ROOM * layout.length(clear):
        x, y = layout.pixels(placed(centre, parcel.pose)).tolist()
        ink.draw_badge(canvas, text, size, colour, center=(round(x), round(y)))


@lru_cache(maxsize=16)
def _flash(radius: int) -> pygame.Surface:
    """Paint a star of a radius [px]."""
    picture = pygame.Surface((2 * radius + 2, 2 * radius + 2), pygame.SRCALPHA)
    picture.fill((*ink.PAPER, 0))
    angles = np.pi * np.arange(2 * _SPIKES) / _SPIKES
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for share, colour in ((1.0, ink.PAPER), (0.8, ink.GOAL), (0.4, ink.PAPER)):
        reach = share * radius * np.where(np.arange(2 * _SPIKES) % 2, 0.5, 1.0)
        ink.polygon(picture, radius + 1.0 + reach[:, np.newaxis] * rays, colour)
    return picture


ANGLES = 180  # number of module pictures in half a turn
_PALE = 0.62  # share of the plate's colour in a module that does not obey
_BAND = 1.0  # [cells] thickness of a hatched exit
_ARROW = 2.4  # [cells] length of the arrow through an exit
_PATH_STEP = 2.0  # [px] between a path's points
_QUEUE_SHOWN = 3  # maximum number of parcels drawn at the entry
_BAR = 0.3  # [cells] thickness of the bar beside mouths
_FAINT = 0.75  # share of the paper in an inlet
_PALEST, _DARKEST = 0.86, 0.45  # shares of the plate in an exit, inside and outside


SPEED_LEVELS, FAST = 4, 2.0  # lengths of an arrow, and the speed [m/s] of the longest


class ModuleSprites:
    """Cached pictures: idle modules with a bar along the axis, and driven modules with an arrow."""

    def __init__(self, cell: int) -> None:
        self.cell = cell
        # pictures by step, speed level (negative: an idle rotor) and paleness
        self._sprites: dict[tuple[int, int, bool], pygame.Surface] = {}

    def sprite(self, step: int, pale: bool) -> pygame.Surface:
        """Return the picture of an idle module with its axis at pi * step / ANGLES [rad]."""
        return self.arrow(step, -1, pale)

    def arrow(self, step: int, level: int, pale: bool) -> pygame.Surface:
        """Return the picture of a driven module.

        Args:
            step: the module's surface moves towards pi * step / ANGLES [rad].
            level: speed of the surface, from 0 (a stop) to `SPEED_LEVELS`.
            pale: whether the picture is pale, for a module that does not obey.
        """
        key = (step, level, pale)
        if key not in self._sprites:
            self._sprites[key] = self._painted(math.pi * step / ANGLES, level, pale)
        return self._sprites[key]

    def _painted(self, angle: float, level: int, pale: bool) -> pygame.Surface:
        """Paint a disc with a mark: a bar along `angle` [rad], a dot, or an arrow.

        The bar is for level -1, the dot is for level 0, and the arrow is for higher levels.
        """
        colour, line = ink.axis_colour(angle) if level < 0 else ink.DRIVEN, ink.PAPER
        if pale:
            colour, line = ink.mixed(colour, ink.PLATE, _PALE), ink.mixed(line, ink.PLATE, _PALE)
        picture = pygame.Surface((self.cell, self.cell), pygame.SRCALPHA)
        picture.fill((*colour, 0))
        half = 0.5 * self.cell
        centre = np.array([half, half])
        ink.disc(picture, centre, 0.86 * half, colour)
        way = half * np.array([math.cos(angle), -math.sin(angle)])
        if level < 0:
            along = 0.60 * way
            width = max(0.26 * half, 1.0)
            ink.line(picture, np.array([centre - along, centre + along]), width, line)
        elif level == 0:
            ink.disc(picture, centre, 0.2 * half, line)
        else:
            _paint_arrow(picture, centre, way, level / SPEED_LEVELS, line)
        return picture


def _paint_arrow(
    picture: pygame.Surface, centre: Array, way: Array, share: float, colour: ink.Colour
) -> None:
    """Paint an arrow with its middle at `centre` and its direction along `way` (2,) [px].

    `share` [-] is the ratio of the module's speed to the top speed. Fast modules have long arrows.
    """
    side, width = np.array([-way[1], way[0]]), max(0.2 * float(np.hypot(*way)), 1.0)
    reach = (0.3 + 0.38 * share) * way
    tip, tail = centre + reach, centre - reach
    back = tip - 0.36 * way
    ink.line(picture, np.array([tail, tip]), width, colour)
    ink.line(picture, np.array([back + 0.34 * side, tip, back - 0.34 * side]), width, colour)


def paint_ground(layout: PixelLayout, scene: Scene) -> pygame.Surface:
    """Paint what does not change: supports, zone, exits, and the areas for the exits' labels."""
    sheet = pygame.Surface(layout.area.bottomright, depth=32)
    sheet.fill(ink.PAPER)
    sheet.set_clip(layout.plate)
    sheet.blit(_paint_plate(layout, scene), layout.surface)
    sheet.set_clip(None)
    if scene.traffic is not None:
        pygame.draw.rect(sheet, ink.PLATE_EDGE, layout.plate, 1)
        for index, inlet in enumerate(scene.traffic.inlets):
            _paint_inlet(sheet, layout, inlet, ink.exit_colour(index))
        _paint_closed(sheet, layout, scene.exits)
    for index, mark in enumerate(scene.exits):
        _paint_exit(sheet, layout, mark, exit_colour(scene, index))
    return sheet.subsurface(layout.area).copy()


def _paint_plate(layout: PixelLayout, scene: Scene) -> pygame.Surface:
    """Paint the background of the whole surface, with supports and zone."""
    plate = pygame.Surface(layout.surface.size, depth=32)
    plate.fill(ink.PLATE)
    zone = None
    if scene.zone is not None:
        zone = layout.cells(*scene.zone).move(-layout.left, -layout.top)
        plate.fill(ink.ZONE, zone)
    radius = max(0.07 * layout.cell, 0.6)
    for row, column in np.argwhere(~scene.rotor).tolist():
        cell = layout.cells(row, 1, column, 1).move(-layout.left, -layout.top)
        centre = np.array([cell.x + 0.5 * cell.width, cell.y + 0.5 * cell.height])
        ink.disc(plate, centre, radius, ink.SUPPORT)
    pygame.draw.rect(plate, ink.PLATE_EDGE, plate.get_rect(), 1)
    if zone is not None:
        pygame.draw.rect(plate, ink.ZONE_EDGE, zone, max(1, round(0.75 * layout.stroke)))
    return plate


def draw_modules(
    canvas: pygame.Surface, layout: PixelLayout, sprites: ModuleSprites, scene: Scene
) -> None:
    """Draw each rotor's module; modules that do not obey are pale."""
    row, column = np.nonzero(scene.rotor)
    steps = np.rint(scene.axis[row, column] * (ANGLES / math.pi)).astype(np.int64) % ANGLES
    pale = ~scene.obeys[row, column]
    left = layout.left + layout.width * column + (layout.width - layout.cell) // 2
    top = layout.top + layout.height * (layout.rows - 1 - row) + (layout.height - layout.cell) // 2
    looks = zip(steps.tolist(), pale.tolist(), strict=True)
    pictures = [sprites.sprite(step, is_pale) for step, is_pale in looks]
    if scene.drive is not None:
        vx, vy = scene.drive[row, column].T
        speed = np.hypot(vx, vy)
        turned = np.rint(np.arctan2(vy, vx) * (ANGLES / math.pi))
        levels = np.ceil(SPEED_LEVELS * np.minimum(1.0, speed / FAST))
        for k in np.flatnonzero(~np.isnan(vx)).tolist():
            pictures[k] = sprites.arrow(int(turned[k]), int(levels[k]), bool(pale[k]))
    corners = zip(left.tolist(), top.tolist(), strict=True)
    canvas.fblits(list(zip(pictures, corners, strict=True)))


def draw_goal(canvas: pygame.Surface, layout: PixelLayout, scene: Scene) -> None:
    """Draw the goal, but not the goal's label, under the parcels."""
    goal = scene.goal
    if isinstance(goal, scenes.ExitSide):
        _draw_gate(canvas, layout, scene, goal.side)
    elif isinstance(goal, scenes.ExitSpeed):
        _draw_gate(canvas, layout, scene, 0)
    elif isinstance(goal, StopLine):
        line = _stop_line(layout, scene, goal)
        ink.dashes(canvas, line, layout.stroke, ink.GOAL, 4.0 * layout.stroke)
    elif isinstance(goal, scenes.Path):
        points = ink.thinned(layout.pixels(goal.points), _PATH_STEP)
        ink.line(canvas, points, 2.6 * layout.stroke, ink.PAPER, 0.7)
        ink.dashes(canvas, points, layout.stroke, ink.GOAL, 7.0 * layout.stroke)
        ink.disc(canvas, points[-1], 2.5 * layout.stroke, ink.GOAL)


def label_goal(canvas: pygame.Surface, layout: PixelLayout, scene: Scene, size: int) -> None:
    """Write the goal's label beside the goal, with a font of `size` [px]."""
    goal = scene.goal
    if isinstance(goal, StopLine):
        top = _stop_line(layout, scene, goal)[1]
        place = (round(top[0]), round(top[1]) - 5)
        text = f"stop at x = {goal.x:.2f} m"
        ink.write_on_plate(canvas, text, size, ink.GOAL, layout.surface, midbottom=place)
    elif isinstance(goal, scenes.ExitSpeed):
        band, _ = _gate(layout, scene, 0)
        text = f"leave at {goal.speed:.2f} m/s ({goal.ratio:.2f} of entry)"
        place = (band.right, band.top - 7)
        ink.write_on_plate(canvas, text, size, ink.GOAL, layout.surface, bottomright=place)


def draw_asked_heading(
    canvas: pygame.Surface, layout: PixelLayout, goal: scenes.Heading, parcel: SceneParcel
) -> None:
    """Draw the base at the goal's angle, and an arc from the parcel's angle to the goal's angle."""
    angle, outline, pose = goal.angle, parcel.outline, parcel.pose
    local = centroid(outline)
    centre = placed(local, pose)
    cosine, sine = math.cos(angle), math.sin(angle)
    x = centre[0] - cosine * local[0] + sine * local[1]
    y = centre[1] - sine * local[0] - cosine * local[1]
    asked = (float(x), float(y), angle)
    corners = layout.pixels(placed(outline, asked))
    closed = np.vstack([corners, corners[:1]])
    ink.dashes(canvas, closed, layout.stroke, ink.GOAL, 4.0 * layout.stroke)
    draw_heading(canvas, layout, outline, asked, ink.GOAL)
    turn = math.remainder(angle - pose[2], 2.0 * math.pi)
    radius = 0.4 * (outline[:, 0].max() - local[0])
    headings = pose[2] + np.linspace(0.0, turn, 24)
    arc = centre + radius * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    ink.line(canvas, layout.pixels(arc), layout.stroke, ink.GOAL)


def draw_counts(canvas: pygame.Surface, layout: PixelLayout, scene: Scene) -> None:
    """Write each exit's number of delivered parcels, and each entry's number of waiting parcels."""
    if scene.traffic is None:
        return
    for index, mark in enumerate(scene.exits):
        count = scene.traffic.delivered[index]
        _write_label(canvas, layout, mark, exit_colour(scene, index), count)
    if not scene.traffic.inlets:
        _draw_queue(canvas, layout, scene.traffic.waiting)
    for inlet, count in zip(scene.traffic.inlets, scene.traffic.queues, strict=True):
        _write_queue(canvas, layout, inlet, count)


def exit_colour(scene: Scene, index: int) -> ink.Colour:
    """Return an exit's colour. If a conveyor follows, the colour shows if the conveyor runs."""
    runs = None if scene.traffic is None else scene.traffic.runs
    if runs is None:
        return ink.exit_colour(index)
    return ink.RUNS if runs else ink.STANDS


def _line_area(layout: PixelLayout, scene: Scene) -> pygame.Rect:
    """Return the area of the rotor rows in the zone's columns; goals are drawn beside this area."""
    columns = np.flatnonzero(scene.rotor.any(axis=0))
    if len(columns) == 0:
        return layout.surface
    first_column, count = int(columns[0]), int(np.ptp(columns)) + 1
    if scene.zone is not None:
        first_column, count = scene.zone[2:]
    return layout.cells(*layout.line, first_column, count)


def _gate(layout: PixelLayout, scene: Scene, side: int) -> tuple[pygame.Rect, tuple[float, float]]:
    """Return the area of an exit's hatched band, and the outward direction (x, y) in the picture.

    The exit is at y > 0 if `side` is 1, at y < 0 if `side` is -1, and at the zone's end if
    `side` is 0.
    """
    line, depth = _line_area(layout, scene), round(_BAND * layout.cell)
    if side == 0:
        band = pygame.Rect(line.right, line.top, depth, line.height)
    elif side > 0:
        band = pygame.Rect(line.left, line.top - depth, line.width, depth)
    else:
        band = pygame.Rect(line.left, line.bottom, line.width, depth)
    return band.clamp(layout.surface), (0.0, -float(side)) if side else (1.0, 0.0)


def _draw_gate(canvas: pygame.Surface, layout: PixelLayout, scene: Scene, side: int) -> None:
    """Draw the hatched band of an exit at a side (see `_gate`), with an outward arrow."""
    band, outward = _gate(layout, scene, side)
    ends = {0: ("topleft", "bottomleft"), 1: ("bottomleft", "bottomright")}
    edge = np.array(
        [getattr(band, corner) for corner in ends.get(side, ("topleft", "topright"))],
        dtype=np.float64,
    )
    ink.hatching(canvas, band, 0.28 * layout.cell, 0.6 * layout.stroke, ink.GOAL, 0.55)
    ink.line(canvas, edge, layout.stroke, ink.GOAL)
    reach = _ARROW * layout.cell * np.array(outward)
    surface = layout.surface
    tip = np.clip(edge.mean(axis=0) + reach, surface.topleft, surface.bottomright)
    ink.arrow(canvas, tip - reach, tip, 2.0 * layout.stroke, ink.GOAL)


def _stop_line(layout: PixelLayout, scene: Scene, goal: StopLine) -> Array:
    """Compute the ends (2, 2) [px] of the stop line, across all rotor rows at the goal's x."""
    line = _line_area(layout, scene).inflate(0, 3 * layout.cell).clip(layout.surface)
    x = float(layout.pixels((goal.x, 0.0))[0])
    return np.array([[x, line.bottom], [x, line.top]])


def _paint_exit(
    canvas: pygame.Surface, layout: PixelLayout, mark: scenes.ExitMark, colour: ink.Colour
) -> None:
    """Paint an exit's constant parts, i.e. the exit's area and the background of the label."""
    mouth, label, cell = layout.mouth(mark), layout.label(mark), layout.cell
    _paint_fading(canvas, mouth, mark.side, colour)
    rail = max(2, cell // 6)
    if mark.side == 0:
        pygame.draw.rect(canvas, colour, (mouth.left, mouth.top - rail, mouth.width, rail))
        pygame.draw.rect(canvas, colour, (mouth.left, mouth.bottom, mouth.width, rail))
        _paint_pointed(canvas, label.inflate(0, 2 * rail), colour)
        return
    pygame.draw.rect(canvas, colour, (mouth.left, mouth.top, rail, mouth.height))
    pygame.draw.rect(canvas, colour, (mouth.right - rail, mouth.top, rail, mouth.height))
    _paint_chevron(canvas, mouth, mark.side, cell, colour)
    rounded = round(0.4 * cell)
    top, bottom = (rounded, 0) if mark.side > 0 else (0, rounded)
    pygame.draw.rect(
        canvas, colour, label, border_top_left_radius=top, border_top_right_radius=top,
        border_bottom_left_radius=bottom, border_bottom_right_radius=bottom,
    )  # fmt: skip


def _paint_closed(
    canvas: pygame.Surface, layout: PixelLayout, exits: Sequence[scenes.ExitMark]
) -> None:
    """If exits cover only parts of the line's end, paint a bar over the other parts."""
    mouths = [layout.mouth(mark) for mark in exits if mark.span is not None]
    if not mouths:
        return
    rotors, left = layout.rotors, min(mouth.left for mouth in mouths)
    bar = max(2, round(_BAR * layout.cell))
    behind = pygame.Rect(left, rotors.top, layout.plate.right - left, rotors.height)
    canvas.fill(ink.mixed(ink.PLATE, ink.PLATE_EDGE, 0.6), behind)
    top = rotors.top
    for mouth in [*sorted(mouths, key=lambda each: each.top), pygame.Rect(0, rotors.bottom, 0, 0)]:
        if mouth.top > top:
            canvas.fill(ink.FAINT_INK, pygame.Rect(left, top, bar, mouth.top - top))
        top = max(top, mouth.bottom)


def _paint_inlet(
    canvas: pygame.Surface, layout: PixelLayout, mark: scenes.InletMark, colour: ink.Colour
) -> None:
    """Paint the constant part of an inlet: a pale area between two rails."""
    area, rail = layout.inlet(mark), max(2, layout.cell // 8)
    canvas.fill(ink.mixed(colour, ink.PAPER, _FAINT), area)
    if mark.side == 0:
        for top in (area.top, area.bottom - rail):
            canvas.fill(colour, pygame.Rect(area.left, top, area.width, rail))
        return
    for left in (area.left, area.right - rail):
        canvas.fill(colour, pygame.Rect(left, area.top, rail, area.height))


def _paint_fading(canvas: pygame.Surface, area: pygame.Rect, side: int, colour: ink.Colour) -> None:
    """Fill an exit's area with a colour that gets stronger outwards. For `side` see `_gate`."""
    length = area.height if side else area.width
    for k in range(length):
        shade = ink.mixed(colour, ink.PLATE, _PALEST + (_DARKEST - _PALEST) * (k + 0.5) / length)
        if side:
            y = area.bottom - 1 - k if side > 0 else area.top + k
            canvas.fill(shade, pygame.Rect(area.left, y, area.width, 1))
        else:
            canvas.fill(shade, pygame.Rect(area.left + k, area.top, 1, area.height))


def _paint_chevron(
    canvas: pygame.Surface, mouth: pygame.Rect, side: int, cell: int, colour: ink.Colour
) -> None:
    """If an exit's area `mouth` is at least 2 * `cell` high, paint two outward chevrons in it."""
    if mouth.height < 2 * cell:
        return
    width = min(2.4 * cell, 0.4 * mouth.width)
    middle = np.array([mouth.centerx, mouth.centery], dtype=np.float64)
    for step in (-0.5, 0.5):
        tip = middle - [0.0, side * (step + 0.5) * cell]
        arm = np.array([0.5 * width, side * 0.3 * width])
        points = np.array([tip + arm * [-1.0, 1.0], tip, tip + arm])
        ink.line(canvas, points, 0.3 * cell, colour, 0.8)


def _paint_pointed(canvas: pygame.Surface, area: pygame.Rect, colour: ink.Colour) -> None:
    """Fill an area with a rectangle whose right end is pointed."""
    neck = area.right - 0.25 * area.width
    upper, lower = (neck, area.top), (neck, area.bottom)
    corners = [area.topleft, upper, (area.right, area.centery), lower, area.bottomleft]
    ink.polygon(canvas, np.array(corners, dtype=np.float64), colour)


def _write_label(
    canvas: pygame.Surface,
    layout: PixelLayout,
    mark: scenes.ExitMark,
    colour: ink.Colour,
    count: int,
) -> None:
    """Write an exit's name, cut to the available room, and the exit's count of parcels."""
    label, size, text = layout.label(mark), layout.label_size, ink.text_on(colour)
    if mark.side:
        _write_in_line(canvas, label, size, (mark.name, str(count)), text)
        return
    room = round(0.75 * label.width)
    place = (label.left + label.width * 3 // 7, label.centery + size // 10)
    ink.write(canvas, mark.name, size, text, room, midbottom=place)
    ink.write(canvas, str(count), round(1.25 * size), text, room, midtop=place)


def _write_in_line(
    canvas: pygame.Surface, area: pygame.Rect, size: int, texts: tuple[str, str], colour: ink.Colour
) -> None:
    """Write a name, and then a number in larger type, in the middle of an area."""
    (name, number), large, gap = texts, round(1.25 * size), size // 2
    taken = ink.text_width(number, large)
    wide = min(ink.text_width(name, size), max(1, area.width - taken - 2 * gap))
    left, middle = area.centerx - (wide + gap + taken) // 2, area.centery + 1
    ink.write(canvas, name, size, colour, wide, midleft=(left, middle))
    ink.write(canvas, number, large, colour, midleft=(left + wide + gap, middle))


def _draw_queue(canvas: pygame.Surface, layout: PixelLayout, waiting: int) -> None:
    """Draw some of the parcels that wait at the entry; write how many parcels wait in total."""
    cell, rotors, size = layout.cell, layout.rotors, layout.label_size
    left, right, begin = layout.area.left, rotors.left, rotors.bottom
    if begin + round(1.6 * cell) + 2 * size > layout.area.bottom:  # rotors take all rows
        begin = rotors.centery - 2 * cell
    side, step = round(0.8 * cell), round(1.05 * cell)
    shown, rounded = min(waiting, _QUEUE_SHOWN), max(1, cell // 8)
    middle, x = (left + right) // 2, (left + right - (shown - 1) * step) // 2
    for k in range(shown):
        box = pygame.Rect(0, 0, side, side)
        box.midtop = (x + k * step, begin + cell // 2)
        pygame.draw.rect(canvas, ink.mixed(ink.PARCEL, ink.PLATE, 0.3), box, border_radius=rounded)
        pygame.draw.rect(canvas, ink.INK, box, max(1, cell // 10), border_radius=rounded)
    colour, room = ink.INK if waiting else ink.FAINT_INK, right - left
    place = (middle, begin + round(1.6 * cell))
    number = ink.write(canvas, str(waiting), round(1.5 * size), colour, room, midtop=place)
    if ink.text_width("waiting", size) <= room:
        ink.write(canvas, "waiting", size, colour, midtop=(middle, number.bottom))


def _write_queue(
    canvas: pygame.Surface, layout: PixelLayout, mark: scenes.InletMark, count: int
) -> None:
    """Write an inlet's number of waiting parcels. If there is room, write the inlet's name, too."""
    area, size, large = layout.inlet(mark), layout.label_size, round(1.25 * layout.label_size)
    colour = ink.INK if count else ink.FAINT_INK
    x, y = area.center
    room = area.width - size // 2
    if mark.side:
        _write_in_line(canvas, area, size, (mark.name, str(count)), colour)
        return
    if area.height < 2 * size:
        ink.write(canvas, str(count), size, colour, room, center=(x, y))
        return
    ink.write(canvas, mark.name, size, colour, room, midbottom=(x, y + size // 10))
    ink.write(canvas, str(count), large, colour, room, midtop=(x, y + size // 10))

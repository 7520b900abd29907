"""The surface: supports, zone, modules, goals, and the exits and the queue beside the line."""

import math

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering import ink
from surface_gym.rendering.ink import FAINT_INK, GOAL, INK, PAPER, PLATE, Colour, mixed
from surface_gym.rendering.parcel_marks import centroid, draw_heading, placed
from surface_gym.rendering.scene import (
    ExitMark,
    ExitSide,
    ExitSpeed,
    Heading,
    Layout,
    Path,
    Scene,
    SceneParcel,
    StopLine,
)

Array = NDArray[np.float64]

ANGLES = 180  # pictures of a module in half a turn
_PALE = 0.62  # share of the plate's colour in a module that does not obey
_BAND = 1.0  # [cells] thickness of a hatched exit
_ARROW = 2.4  # [cells] length of the arrow through it
_PATH_STEP = 2.0  # [px] between a path's points
_QUEUE_SHOWN = 3  # parcels drawn at the entry, at most
_PALEST, _DARKEST = 0.86, 0.45  # shares of the plate in an exit, inside and outside


class ModuleSprites:
    """Pictures of a module, a disc with a bar along its axis, by axis angle; made when asked for.

    Args:
        cell: [px] width and height.
    """

    def __init__(self, cell: int) -> None:
        self.cell = cell
        self._sprites: dict[tuple[int, bool], pygame.Surface] = {}

    def sprite(self, step: int, pale: bool) -> pygame.Surface:
        """Return the picture of a module whose axis is at `step` of `ANGLES` in half a turn."""
        key = (step, pale)
        if key not in self._sprites:
            self._sprites[key] = self._painted(math.pi * step / ANGLES, pale)
        return self._sprites[key]

    def _painted(self, angle: float, pale: bool) -> pygame.Surface:
        colour, bar = ink.axis_colour(angle), PAPER
        if pale:
            colour, bar = mixed(colour, PLATE, _PALE), mixed(bar, PLATE, _PALE)
        picture = pygame.Surface((self.cell, self.cell), pygame.SRCALPHA)
        picture.fill((*colour, 0))
        half = 0.5 * self.cell
        centre = np.array([half, half])
        along = 0.60 * half * np.array([math.cos(angle), -math.sin(angle)])
        ink.disc(picture, centre, 0.86 * half, colour)
        ink.line(picture, np.array([centre - along, centre + along]), max(0.26 * half, 1.0), bar)
        return picture


def paint_ground(layout: Layout, scene: Scene) -> pygame.Surface:
    """Paint all that never changes: supports, zone, exits and the grounds of their labels."""
    sheet = pygame.Surface(layout.area.bottomright, depth=32)
    sheet.fill(PAPER)
    sheet.set_clip(layout.plate)
    sheet.blit(_paint_plate(layout, scene), layout.surface)
    sheet.set_clip(None)
    if scene.traffic is not None:
        pygame.draw.rect(sheet, ink.PLATE_EDGE, layout.plate, 1)
    for index, mark in enumerate(scene.exits):
        _paint_exit(sheet, layout, mark, ink.exit_colour(index))
    return sheet.subsurface(layout.area).copy()


def _paint_plate(layout: Layout, scene: Scene) -> pygame.Surface:
    """Paint the supports' plate and the zone, of the size of the whole surface."""
    plate = pygame.Surface(layout.surface.size, depth=32)
    plate.fill(PLATE)
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
    canvas: pygame.Surface, layout: Layout, sprites: ModuleSprites, scene: Scene
) -> None:
    """Draw each rotor's module, pale where it does not obey."""
    row, column = np.nonzero(scene.rotor)
    steps = np.rint(scene.axis[row, column] * (ANGLES / math.pi)).astype(np.int64) % ANGLES
    pale = ~scene.obeys[row, column]
    left = layout.left + layout.width * column + (layout.width - layout.cell) // 2
    top = layout.top + layout.height * (layout.rows - 1 - row) + (layout.height - layout.cell) // 2
    looks = zip(steps.tolist(), pale.tolist(), strict=True)
    pictures = [sprites.sprite(step, is_pale) for step, is_pale in looks]
    corners = zip(left.tolist(), top.tolist(), strict=True)
    canvas.fblits(list(zip(pictures, corners, strict=True)))


def draw_goal(canvas: pygame.Surface, layout: Layout, scene: Scene) -> None:
    """Draw the goal under the parcels, without its label."""
    goal = scene.goal
    if isinstance(goal, ExitSide):
        _draw_gate(canvas, layout, scene, goal.side)
    elif isinstance(goal, ExitSpeed):
        _draw_gate(canvas, layout, scene, 0)
    elif isinstance(goal, StopLine):
        line = _stop_line(layout, scene, goal)
        ink.dashes(canvas, line, layout.stroke, GOAL, 4.0 * layout.stroke)
    elif isinstance(goal, Path):
        points = ink.thinned(layout.pixels(goal.points), _PATH_STEP)
        ink.line(canvas, points, 2.6 * layout.stroke, PAPER, 0.7)
        ink.dashes(canvas, points, layout.stroke, GOAL, 7.0 * layout.stroke)
        ink.disc(canvas, points[-1], 2.5 * layout.stroke, GOAL)


def label_goal(canvas: pygame.Surface, layout: Layout, scene: Scene, size: int) -> None:
    """Write what the goal asks beside it."""
    goal = scene.goal
    if isinstance(goal, StopLine):
        top = _stop_line(layout, scene, goal)[1]
        place = (round(top[0]), round(top[1]) - 5)
        text = f"stop at x = {goal.x:.2f} m"
        ink.write_on_plate(canvas, text, size, GOAL, layout.surface, midbottom=place)
    elif isinstance(goal, ExitSpeed):
        band, _ = _gate(layout, scene, 0)
        text = f"leave at {goal.speed:.2f} m/s ({goal.ratio:.2f} of entry)"
        place = (band.right, band.top - 7)
        ink.write_on_plate(canvas, text, size, GOAL, layout.surface, bottomright=place)


def draw_asked_heading(
    canvas: pygame.Surface, layout: Layout, goal: Heading, parcel: SceneParcel
) -> None:
    """Draw the base turned to the asked angle about its own centre, and the turn that is left."""
    angle, outline, pose = goal.angle, parcel.outline, parcel.pose
    local = centroid(outline)
    centre = placed(local, pose)
    cosine, sine = math.cos(angle), math.sin(angle)
    x = centre[0] - cosine * local[0] + sine * local[1]
    y = centre[1] - sine * local[0] - cosine * local[1]
    asked = (float(x), float(y), angle)
    corners = layout.pixels(placed(outline, asked))
    closed = np.vstack([corners, corners[:1]])
    ink.dashes(canvas, closed, layout.stroke, GOAL, 4.0 * layout.stroke)
    draw_heading(canvas, layout, outline, asked, GOAL)
    turn = math.remainder(angle - pose[2], 2.0 * math.pi)
    radius = 0.4 * (outline[:, 0].max() - local[0])
    headings = pose[2] + np.linspace(0.0, turn, 24)
    arc = centre + radius * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    ink.line(canvas, layout.pixels(arc), layout.stroke, GOAL)


def draw_counts(canvas: pygame.Surface, layout: Layout, scene: Scene) -> None:
    """Write the counts of parcels: on the exits those delivered, at the entry those waiting."""
    if scene.traffic is None:
        return
    for index, mark in enumerate(scene.exits):
        _write_label(canvas, layout, mark, ink.exit_colour(index), scene.traffic.delivered[index])
    _draw_queue(canvas, layout, scene.traffic.waiting)


def _line_area(layout: Layout, scene: Scene) -> pygame.Rect:
    """Find the area that a goal refers to: the line's rows, over the zone's columns."""
    columns = np.flatnonzero(scene.rotor.any(axis=0))
    if len(columns) == 0:
        return layout.surface
    first_column, count = int(columns[0]), int(np.ptp(columns)) + 1
    if scene.zone is not None:
        first_column, count = scene.zone[2:]
    return layout.cells(*layout.line, first_column, count)


def _gate(layout: Layout, scene: Scene, side: int) -> tuple[pygame.Rect, tuple[float, float]]:
    """Find the hatched band beyond the line's edge, and its outward direction [px]."""
    line, depth = _line_area(layout, scene), round(_BAND * layout.cell)
    if side == 0:
        band = pygame.Rect(line.right, line.top, depth, line.height)
    elif side > 0:
        band = pygame.Rect(line.left, line.top - depth, line.width, depth)
    else:
        band = pygame.Rect(line.left, line.bottom, line.width, depth)
    return band.clamp(layout.surface), (0.0, -float(side)) if side else (1.0, 0.0)


def _draw_gate(canvas: pygame.Surface, layout: Layout, scene: Scene, side: int) -> None:
    """Draw a band to leave through: hatched, with an arrow outwards."""
    band, outward = _gate(layout, scene, side)
    ends = {0: ("topleft", "bottomleft"), 1: ("bottomleft", "bottomright")}
    edge = np.array(
        [getattr(band, corner) for corner in ends.get(side, ("topleft", "topright"))],
        dtype=np.float64,
    )
    ink.hatching(canvas, band, 0.28 * layout.cell, 0.6 * layout.stroke, GOAL, 0.55)
    ink.line(canvas, edge, layout.stroke, GOAL)
    reach = _ARROW * layout.cell * np.array(outward)
    surface = layout.surface
    tip = np.clip(edge.mean(axis=0) + reach, surface.topleft, surface.bottomright)
    ink.arrow(canvas, tip - reach, tip, 2.0 * layout.stroke, GOAL)


def _stop_line(layout: Layout, scene: Scene, goal: StopLine) -> Array:
    """Compute the ends (2, 2) [px] of a line across the rotors and a little beyond, upwards."""
    line = _line_area(layout, scene).inflate(0, 3 * layout.cell).clip(layout.surface)
    x = float(layout.pixels((goal.x, 0.0))[0])
    return np.array([[x, line.bottom], [x, line.top]])


def _paint_exit(canvas: pygame.Surface, layout: Layout, mark: ExitMark, colour: Colour) -> None:
    """Paint what never changes of an exit: its area, and the ground of its label."""
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
        canvas,
        colour,
        label,
        border_top_left_radius=top,
        border_top_right_radius=top,
        border_bottom_left_radius=bottom,
        border_bottom_right_radius=bottom,
    )


def _paint_fading(canvas: pygame.Surface, area: pygame.Rect, side: int, colour: Colour) -> None:
    """Fill an exit with a colour that grows outwards."""
    length = area.height if side else area.width
    for k in range(length):
        shade = mixed(colour, PLATE, _PALEST + (_DARKEST - _PALEST) * (k + 0.5) / length)
        if side:
            y = area.bottom - 1 - k if side > 0 else area.top + k
            canvas.fill(shade, pygame.Rect(area.left, y, area.width, 1))
        else:
            canvas.fill(shade, pygame.Rect(area.left + k, area.top, 1, area.height))


def _paint_chevron(
    canvas: pygame.Surface, mouth: pygame.Rect, side: int, cell: int, colour: Colour
) -> None:
    """Paint an outward angle in a chute that has room for it."""
    if mouth.height < 2 * cell:
        return
    width = min(2.4 * cell, 0.4 * mouth.width)
    middle = np.array([mouth.centerx, mouth.centery], dtype=np.float64)
    for step in (-0.5, 0.5):
        tip = middle - [0.0, side * (step + 0.5) * cell]
        arm = np.array([0.5 * width, side * 0.3 * width])
        points = np.array([tip + arm * [-1.0, 1.0], tip, tip + arm])
        ink.line(canvas, points, 0.3 * cell, colour, 0.8)


def _paint_pointed(canvas: pygame.Surface, area: pygame.Rect, colour: Colour) -> None:
    """Paint a block that points along x."""
    neck = area.right - 0.25 * area.width
    upper, lower = (neck, area.top), (neck, area.bottom)
    corners = [area.topleft, upper, (area.right, area.centery), lower, area.bottomleft]
    ink.polygon(canvas, np.array(corners, dtype=np.float64), colour)


def _write_label(
    canvas: pygame.Surface, layout: Layout, mark: ExitMark, colour: Colour, count: int
) -> None:
    """Write an exit's name and its count of parcels; what has no room is cut."""
    label, size, text = layout.label(mark), layout.label_size, ink.text_on(colour)
    number, large = str(count), round(1.25 * size)
    if mark.side == 0:
        room = round(0.75 * label.width)
        place = (label.left + label.width * 3 // 7, label.centery + size // 10)
        ink.write(canvas, mark.name, size, text, room, midbottom=place)
        ink.write(canvas, number, large, text, room, midtop=place)
        return
    gap, taken = size // 2, ink.text_width(number, large)
    room = max(1, label.width - taken - 2 * gap)
    name = min(ink.text_width(mark.name, size), room)
    left = label.centerx - (name + gap + taken) // 2
    middle = label.centery + 1
    ink.write(canvas, mark.name, size, text, room, midleft=(left, middle))
    ink.write(canvas, number, large, text, midleft=(left + name + gap, middle))


def _draw_queue(canvas: pygame.Surface, layout: Layout, waiting: int) -> None:
    """Draw the number of parcels that wait at the entry."""
    cell, rotors, size = layout.cell, layout.rotors, layout.label_size
    left, right = layout.area.left, rotors.left
    side, step = round(0.8 * cell), round(1.05 * cell)
    shown, rounded = min(waiting, _QUEUE_SHOWN), max(1, cell // 8)
    middle, x = (left + right) // 2, (left + right - (shown - 1) * step) // 2
    for k in range(shown):
        box = pygame.Rect(0, 0, side, side)
        box.midtop = (x + k * step, rotors.bottom + cell // 2)
        pygame.draw.rect(canvas, mixed(ink.PARCEL, PLATE, 0.3), box, border_radius=rounded)
        pygame.draw.rect(canvas, INK, box, max(1, cell // 10), border_radius=rounded)
    colour, room = INK if waiting else FAINT_INK, right - left
    place = (middle, rotors.bottom + round(1.6 * cell))
    number = ink.write(canvas, str(waiting), round(1.5 * size), colour, room, midtop=place)
    if ink.text_width("waiting", size) <= room:
        ink.write(canvas, "waiting", size, colour, midtop=(middle, number.bottom))

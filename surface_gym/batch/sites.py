"""Which parcel runs on which lane: rows of `Sites`, shared where parcels are alike."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.batch.placement import NO_EDGE, Placement
from surface_gym.dynamics.types import Booleans, Integers
from surface_gym.lanes.memory import Sites
from surface_gym.parcel import Parcel
from surface_gym.tasks.start import Parcels

FEWEST_EDGES = 4


class SitePlan:
    """The sites of a batch. The parcels that a task draws have a site each; any other parcel has
    that of its lane.

    Args:
        parcels: that the task draws.
        place: the placement of a parcel.
        lanes: their number.
        shape: (rows, columns) of the plant.
    """

    def __init__(
        self,
        parcels: Sequence[Parcel],
        place: Callable[[Parcel], Placement],
        lanes: int,
        shape: tuple[int, int],
    ) -> None:
        self._place = place
        self._lanes = lanes
        self._shared = len(parcels)
        self._parcels: NDArray[Any] = np.full(self._shared + lanes, None, dtype=object)
        self._site_of = {parcel: site for site, parcel in enumerate(parcels)}
        self.sites = _make_sites(self._shared, shape, FEWEST_EDGES)
        for site, parcel in enumerate(parcels):
            self._write(site, parcel)

    def shared_sites_of(self, parcels: Parcels) -> Integers:
        """(count,) sites of parcels that the task draws; -1 for any other."""
        found = np.array([self._site_of.get(parcel, -1) for parcel in parcels.kinds])
        sites: Integers = found[parcels.which]
        return sites

    def sites_of(self, chosen: Integers, parcels: Parcels) -> Integers:
        """(count,) sites for the parcels of the chosen lanes (count,)."""
        sites = self.shared_sites_of(parcels)
        for k in np.nonzero(sites < 0)[0].tolist():
            sites[k] = self._own(int(chosen[k]), parcels.kinds[parcels.which[k]])
        return sites

    def draw_stuck(self, lane: int, parcel: Parcel, working: Booleans) -> int:
        """The lane's own site, of whose modules those not working (rows, columns) do not obey."""
        site = self._own(lane, parcel)
        self.sites.obeys[site] = self._place(parcel).obeys & working
        return site

    def parcel(self, site: int) -> Parcel:
        """The parcel of a site that was placed."""
        parcel = self._parcels[site]
        assert isinstance(parcel, Parcel)
        return parcel

    def _own(self, lane: int, parcel: Parcel) -> int:
        site = self._shared + lane
        if len(self.sites.zone) == self._shared:
            more = _make_sites(self._lanes, self.sites.rotor.shape[1:], self.sites.edges.shape[1])
            self.sites = Sites._make(map(np.concatenate, zip(self.sites, more, strict=True)))
        if self._parcels[site] is not parcel:
            self._write(site, parcel)
        return site

    def _write(self, site: int, parcel: Parcel) -> None:
        placement = self._place(parcel)
        self.sites = with_body(self.sites, site, placement)
        self.sites.rotor[site] = placement.rotor
        self.sites.obeys[site] = placement.obeys
        self.sites.zone[site] = placement.zone
        self._parcels[site] = parcel


def with_body(sites: Sites, site: int, placement: Placement) -> Sites:
    """Sites with a placement's body in one of their rows; they are others where there was no room
    for so many edges.
    """
    wide = sites.edges.shape[1]
    more = placement.sides - wide
    if more > 0:
        no_edges = np.tile(NO_EDGE, (len(sites.edges), more, 1))
        repeats = np.repeat(sites.corners[:, :1], more, axis=1)
        sites = sites._replace(
            edges=np.concatenate([sites.edges, no_edges], axis=1),
            corners=np.concatenate([sites.corners, repeats], axis=1),
        )
    sites.body[site] = placement.body
    sites.edges[site], sites.corners[site] = placement.fill(wide + max(0, more))
    return sites


def _make_sites(count: int, shape: tuple[int, ...], edges: int) -> Sites:
    return Sites(
        rotor=np.zeros((count, *shape), dtype=np.bool_),
        obeys=np.zeros((count, *shape), dtype=np.bool_),
        body=np.zeros((count, 7)),
        edges=np.zeros((count, edges, 3)),
        corners=np.zeros((count, edges, 2)),
        zone=np.zeros((count, 4), dtype=np.int64),
    )

"""The benchmark of tracking, on one stream: nobody is swapped."""

from benchmarks.tracking import compare_streams, make_config
from surface_gym.agents.rules import find_rules


def test_no_parcel_is_swapped_and_as_many_are_delivered_as_of_known_parcels() -> None:
    config = make_config("singulate")
    rule = find_rules("singulate")[0].make(config)
    swapped, _, delivered, share = compare_streams("slots", config, rule, [3], 20.0, least=0.95)
    assert swapped.value == 0
    assert delivered.value > 20
    assert share.value >= 0.95

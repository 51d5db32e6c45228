"""The topic table and the prefix trap."""

import pytest

from hapticd.gateway.topics import NAMES, Subscriptions, wanted_by


@pytest.mark.parametrize(
    ("prefix", "topics"),
    [
        (b"servo", {"servo"}),
        (b"servo.raw", {"servo.raw"}),
        (b"servo.", {"servo.raw"}),
        (b"s", {"servo", "servo.raw", "state"}),
        (b"", set(NAMES)),
        (b"servo.raw.more", set()),
        (b"\xff\xfe", set()),
    ],
)
def test_subscription_wants_exactly_its_topic(prefix: bytes, topics: set[str]) -> None:
    assert wanted_by(prefix) == topics


def test_wanted_follows_subscriptions() -> None:
    subscriptions = Subscriptions()
    assert subscriptions.take(b"\1servo") == {"servo"}
    assert subscriptions.take(b"\1st") == {"state"}
    assert subscriptions.wanted == {"servo", "state"}
    assert subscriptions.take(b"\0servo") == frozenset()
    assert subscriptions.wanted == {"state"}


def test_repeated_subscription_is_news_again() -> None:
    subscriptions = Subscriptions()
    assert [subscriptions.take(b"\1state") for _ in range(2)] == [{"state"}, {"state"}]


def test_foreign_prefixes_are_not_kept() -> None:
    subscriptions = Subscriptions()
    for number in range(1000):
        subscriptions.take(b"\1foreign%d" % number)
    subscriptions.take(b"")
    subscriptions.take(b"\7servo")
    assert subscriptions.wanted == frozenset()
    assert not subscriptions._prefixes

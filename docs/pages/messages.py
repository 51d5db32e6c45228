"""Commands and telemetry over ZeroMQ, with the limits of the simulated device."""

from hapticd.gateway.command_server import MOST_QUEUED
from hapticd.gateway.peers import MOST_PARTS, MOST_PEERS, QUEUED_BYTES
from hapticd.gateway.server import MAX_SUBSCRIPTION_BYTES, MESSAGES_QUEUED, REPLIES_QUEUED
from hapticd.protocol.codec import MAX_MESSAGE_BYTES
from hapticd.protocol.journal import EVENTS
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.schemas import json_schema
from hapticd.protocol.telemetry import TOPICS
from hapticd.settings.build import servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from pages.markdown import table
from pages.records import bits_tables, fields_table
from pages.schemas import Schema, described

INTRODUCTION = """# Messages

A command is one msgpack or JSON map, sent to the ROUTER socket `command` in the runtime folder. The reply has the encoding
of the request: `{ok}`, or `{refused}`. Telemetry is
two frames, `[topic, payload]`, on the XPUB socket `telemetry` and on TCP port 9872. Limits below are those of the simulated device
at 1 kHz. `hapticd.client` implements all of this.

The gateway implements ZMTP 3 itself (any ZeroMQ library since 4.0) and bounds every peer. A message has at most {message} bytes (a subscription {subscription}) in
{parts} parts; a message beyond that ends its connection. A socket has {peers} connections. At most {replies} replies or {messages} messages of telemetry wait for a reader, within {queued} MiB;
later ones are dropped. A request behind {requests} others is answered `busy`. A stop goes before them all.

## Commands
"""
EVENTS_TEXT = """## Events

An event has a `kind`, a `code`, the fields in braces below, and a `text`. The text is for people and may change; programs read
the code and the fields.
"""
RECORDS = """## Records of `servo.raw`

One per tick, little-endian, packed. `descr` in each message is this table in numpy's form.
"""


def messages_page() -> str:
    """Commands and telemetry over ZeroMQ, with the limits of the simulated device."""
    found = json_schema(
        CommandLimits.announced(servo_params(load(shipped("config") / "hapticd.toml"), "default"))
    )
    commands = [
        f"### `{model['properties']['cmd']['const']}`\n\n{model['description']}\n\n{_fields(found, model)}"
        for model in (found["$defs"][item["$ref"].rpartition("/")[2]] for item in found["oneOf"])
    ]
    parts = [
        f"### `{name}` of `set`\n\n{_fields(found, found['$defs'][title])}"
        for name, title in (("filters", "Filters"), ("wall", "Wall"))
    ]
    topics = table(
        ("topic", "payload", "rate"),
        [(f"`{topic.name}`", topic.content, topic.rate) for topic in TOPICS],
    )
    events = table(
        ("kind", "code", "text"),
        [(f"`{kind}`", f"`{code}`", "".join(parts)) for code, (kind, *parts) in EVENTS.items()],
    )
    records = f"{fields_table()}\n{bits_tables()}"
    bounds = INTRODUCTION.format(
        ok="{ok: true, id, rev, state, result or receipt}",
        refused="{ok: false, id, error: {code, message, detail}}",
        message=MAX_MESSAGE_BYTES,
        subscription=MAX_SUBSCRIPTION_BYTES,
        parts=MOST_PARTS,
        peers=MOST_PEERS,
        replies=REPLIES_QUEUED,
        messages=MESSAGES_QUEUED,
        queued=QUEUED_BYTES >> 20,
        requests=MOST_QUEUED,
    )
    return "\n".join(
        [bounds, *commands, *parts, "## Topics\n", topics, EVENTS_TEXT, events, RECORDS, records]
    )


def _fields(root: Schema, model: Schema) -> str:
    rows = []
    for name, field in model["properties"].items():
        if name not in ("cmd", "v", "id"):
            unit, takes, _, meaning = described(root, field, False)
            rows.append((f"`{name}`", unit, "table" if "$ref" in str(field) else takes, meaning))
    return table(("field", "unit", "takes", "meaning"), rows) if rows else ""

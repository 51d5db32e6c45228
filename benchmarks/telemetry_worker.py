"""A subscriber of `servo.raw`. Arguments: instance, seconds of recorded time. It prints a line at
the first block, then its result.
"""

import json
import sys

from hapticd.client import Client


def main() -> None:
    """Print two lines: `{}` at the first block, {records, missing} at the end."""
    records = missing = 0
    with Client(sys.argv[1]) as client:
        for block in client.stream("servo.raw", seconds=float(sys.argv[2])):
            if not records:
                print("{}", flush=True)
            else:
                missing += block.gap
            records += len(block.records)
    print(json.dumps({"records": records, "missing": missing}), flush=True)


if __name__ == "__main__":
    main()

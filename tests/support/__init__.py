"""Helpers of the tests: devices, boards, stacks, daemons, hostile peers; no test is in here."""

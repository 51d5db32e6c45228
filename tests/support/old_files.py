"""Files that older versions wrote (tests/support/data) stay readable."""

from support.tree import ROOT

OLD = ROOT / "tests/support/data" / "as-of-0.1"

"""The defects that `make mutate` puts back: each patch still applies and names tests that exist."""

import re
import subprocess
from pathlib import Path

import pytest
from mutate import FOLDER, ROOT, read

PATCHES = sorted(FOLDER.glob("*.patch"))


@pytest.mark.parametrize("path", PATCHES, ids=lambda path: path.stem)
def test_known_defect_can_be_put_back_and_names_the_tests_that_notice(path: Path) -> None:
    check = ["git", "apply", "--check", str(path)]
    applied = subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False)
    assert applied.returncode == 0, f"make the patch anew, the claim stays:\n{applied.stderr}"
    for name in read(path).tests:
        file, _, test = name.partition("[")[0].partition("::")
        # written there, or imported to be run on something else
        found = re.search(rf"^ *(def {test}\(|{test},$)", (ROOT / file).read_text(), re.M)
        assert found, f"{name} is gone; name the test that notices"


def test_header_that_names_no_tests_is_refused(tmp_path: Path) -> None:
    patch = tmp_path / "one.patch"
    patch.write_text("Claim: something holds\n\ndiff --git a/x b/x\n")
    with pytest.raises(SystemExit, match="Killed by"):
        read(patch)

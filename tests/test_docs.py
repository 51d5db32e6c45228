"""The documentation repeats the program's tables, all of them; the table of faults is complete;
the site builds.
"""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import typer.main

from hapticd.cli.app import command_line
from hapticd.faults import BY_CODE, BY_NUMBER, FAULTS
from hapticd.gateway.schemas import MODELS
from hapticd.gateway.telemetry import TOPICS
from hapticd.mailbox.layout import TELEMETRY
from hapticd.settings.config import Hand, Simulation, Touch
from hapticd.settings.load import load
from hapticd.settings.tables import leaves
from hapticd.settings.toml import shipped
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS
from hapticd.units import unit_of

ROOT = Path(__file__).parents[1]
CODES = [fault.code for fault in FAULTS if fault.number]


@pytest.fixture
def layers(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module that draws the layers."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("pages.layers")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the documentation's sources with its generated pages."""
    root = tmp_path_factory.mktemp("site")
    for folder in ("docs", "firmware_iface"):
        shutil.copytree(
            ROOT / folder, root / folder, ignore=shutil.ignore_patterns("generated", "__pycache__")
        )
    for file in ("CHANGELOG.md", "pyproject.toml"):
        shutil.copy(ROOT / file, root)
    subprocess.run([sys.executable, "-B", "docs/generate.py"], cwd=root, check=True)
    return root / "docs"


def page(site: Path, name: str) -> str:
    return (site / "generated" / name).read_text()


# --- the table of faults --------------------------------------------------------------------------


def raised_codes() -> set[str]:
    """Keys of BY_CODE that the package names."""
    found = set()
    for path in (ROOT / "hapticd").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Subscript)
                and isinstance(node.value, ast.Name)
                and node.value.id == "BY_CODE"
            ):
                found.add(ast.literal_eval(node.slice))
    return found


def test_every_fault_is_raised_and_every_raise_is_a_fault() -> None:
    assert raised_codes() == set(CODES)


def test_numbers_and_codes_are_unique() -> None:
    assert len(BY_CODE) == len(BY_NUMBER) == len(FAULTS)
    numbers = [fault.number for fault in FAULTS]
    assert numbers == sorted(numbers)


def test_every_fault_says_what_to_do() -> None:
    assert not [
        fault.code for fault in FAULTS if not (fault.cause and fault.action and fault.remedy)
    ]
    assert not [fault.code for fault in FAULTS[1:] if "reset" not in fault.remedy]


@pytest.mark.parametrize("code", CODES)
def test_every_fault_has_its_page(site: Path, code: str) -> None:
    text = page(site, f"faults/{code}.md")
    fault = BY_CODE[code]
    assert text.startswith(f"# {code}\n")
    assert all(
        part in text
        for part in (
            fault.cause,
            fault.action,
            fault.remedy,
            f"fault == {fault.number}",
            "## What to look at",
        )
    )
    assert f"[`{code}`]({code}.md)" in page(site, "faults/index.md")


def test_no_note_is_left_of_a_fault_that_is_gone() -> None:
    assert sorted(path.stem for path in (ROOT / "docs" / "faults").glob("*.md")) == sorted(CODES)


# --- reference pages ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "part"), [("configuration.md", "config"), ("device.md", "device")]
)
def test_every_key_is_listed_with_its_unit(site: Path, name: str, part: str) -> None:
    plain = load(shipped("config") / "hapticd.toml").plain()
    known = plain.pop("device")
    text = page(site, name)
    for path, _ in leaves(known if part == "device" else plain):
        unit = unit_of(str(path[-1]))
        table = f"## `[{'.'.join(map(str, path))}]`"
        if table in text:  # a list of tables, or a table that is not given
            continue
        assert f"| `{path[-1]}` | {unit} |" in text, path
        assert len(path) == 1 or f"## `[{'.'.join(map(str, path[:-1]))}]`" in text, path


def test_configuration_page_says_range_and_default(site: Path) -> None:
    text = page(site, "configuration.md")
    assert "| `rate_hz` | Hz | number >= 50, <= 20000 | `1000.0` |" in text
    assert '| `on_gateway_loss` |  | `"fault"`, `"hold"` | `"fault"` |' in text
    assert (
        "| `core` |  | integer >= 0 | not set | Left out: the last core that this process may"
        " use. |" in text
    )


def test_every_verb_is_listed(site: Path) -> None:
    text = page(site, "commands.md")
    group = typer.main.get_command(command_line())
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        for verb in (
            [f"{name} {inner}" for inner in command.commands]
            if hasattr(command, "commands")
            else [name]
        ):
            assert f"## `hapticd {verb}`\n" in text


def test_every_message_topic_and_field_is_listed(site: Path) -> None:
    text = page(site, "messages.md")
    assert not [name for name in MODELS if f"### `{name}`\n" not in text]
    assert not [
        topic.name for topic in TOPICS if f"| `{topic.name}` | {topic.content} |" not in text
    ]
    assert not [field[0] for field in TELEMETRY if f"| `{field[0]}` | `{field[1]}" not in text]
    assert "| `K` | N/m | number >= -10000, <= 100000 | virtual stiffness |" in text


@pytest.mark.slow
def test_site_builds_without_a_warning(site: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("sphinx") is None or importlib.util.find_spec("furo") is None:
        pytest.fail(
            "sphinx and furo are missing; install them with `make test` or pip install --group docs"
        )
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        str(site),
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "generated/faults/usb_lost.html").is_file()


# --- names of modules -----------------------------------------------------------------------------

MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
    for file in (ROOT / "hapticd").rglob("*.py")
}
PACKAGES = {name.split(".")[1] for name in MODULES if "." in name} | {"measure"}  # one that was
FILE_ENDINGS = {"conf", "h5", "json", "limits", "rules", "schema", "service", "sysusers"} | {
    "target", "tmpfiles", "toml",
}  # fmt: skip
STATUS_KEYS = {"servo.realtime", "servo.report"}  # of `hapticd status --json`


def names_that_do_not_exist(text: str, settings: set[str]) -> list[str]:
    """Dotted names behind `hapticd.`, those in backticks that begin with a package, and paths, of
    which nothing is there; `settings`: dotted names that mean something else.
    """
    found = re.findall(r"(?<![\w/.-])hapticd\.([a-z]\w*(?:\.\w+)*)", text)
    quoted = re.findall(rf"`((?:{'|'.join(PACKAGES)})(?:\.\w+)+)`", text)
    found += [name for name in quoted if name not in settings]
    for first, more in re.findall(r"`(?:hapticd\.)?([\w.]+)\.\w+`((?:, `\.\w+`)+)", text):
        found += [f"{first}{rest}" for rest in re.findall(r"\.\w+", more)]
    paths = re.findall(r"(?<![\w/])hapticd/[\w/]+\.py", text)
    return [name for name in found if not exists(name)] + [
        path for path in paths if not (ROOT / path).exists()
    ]


def exists(name: str) -> bool:
    """Whether `name` is a module, or is written in the module that its beginning names."""
    parts = re.sub(r"\.(__\w+|NAME)$", "", f"hapticd.{name}").split(".")
    if parts[-1] in FILE_ENDINGS or parts[1] in FILE_ENDINGS - {"limits"}:
        return True
    for count in range(len(parts), 1, -1):
        file = MODULES.get(".".join(parts[:count]))
        if file is not None:
            # the docstring of a package names much that is one layer further down
            code = file.read_text(encoding="utf-8").removeprefix('"""').partition('"""')[2]
            return count == len(parts) or bool(re.search(rf"\b{parts[count]}\b", code))
    return False


def test_every_module_that_is_named_anywhere_exists() -> None:
    """In pages, docstrings, comments and settings; CHANGELOG.md alone names what was."""
    settings = {".".join(map(str, path)) for path, _ in leaves(load(None).plain())}
    settings |= STATUS_KEYS | {topic.name for topic in TOPICS}
    pages = [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "Makefile"]
    for folder, pattern in (
        ("docs", "**/*.md"), ("docs", "pages/*.py"), ("hapticd", "**/*.py"), ("tests", "*.py"),
        ("benchmarks", "*.py"), ("examples", "*"), ("config", "**/*.toml"), ("systemd", "*"),
    ):  # fmt: skip
        pages += sorted(ROOT.joinpath(folder).glob(pattern))
    missing = [
        f"{page.relative_to(ROOT)}:{number}: {name}"
        for page in pages
        if page != Path(__file__) and page.is_file()
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for name in names_that_do_not_exist(line, settings)
    ]
    assert missing == []


def test_every_module_that_moved_is_where_the_changelog_says() -> None:
    table = (ROOT / "CHANGELOG.md").read_text().partition("### Moved")[2].partition("\n#")[0]
    rows = [line.split(" | ") for line in table.splitlines() if line.startswith("| `")]
    assert len(rows) > 80
    assert [name for _, place in rows for name in names_that_do_not_exist(place, set())] == []


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("from `hapticd.analysis.spa`", ["analysis.spa"]),
        ("| `hapticd.zwidth.trial`, `.limits`, `.campaign` | |", ["zwidth.campaign"]),
        ("see `measure.trial` and `zwidth.trial`", ["measure.trial"]),
        ("`plant.stability.damping_floor`", ["plant.stability.damping_floor"]),
        ("in hapticd/sim/engine/job.py, not hapticd/engine/job.py", ["hapticd/sim/engine/job.py"]),
        ("`servo.realtime` of 70-hapticd.rules and hapticd.toml", []),
    ],
)
def test_name_of_a_module_that_is_gone_is_found(line: str, missing: list[str]) -> None:
    assert names_that_do_not_exist(line, STATUS_KEYS) == missing


def test_overview_names_only_files_that_are_there() -> None:
    """Whole paths in its tables, and paths below `hapticd/` in the ways through the files."""
    page = (ROOT / "docs" / "OVERVIEW.md").read_text()
    whole = re.findall(r"`(hapticd/[\w/]+(?:\.py|/))`", page)
    ways = re.findall(r"(?<![\w/`.])([a-z][a-z0-9_]*/[a-z0-9_/]+\.py)\b", page)
    assert len(whole) > 30
    assert len(ways) > 30
    missing = [name for name in whole if not (ROOT / name).exists()]
    missing += [
        name for name in ways if not any((top / name).exists() for top in (ROOT, ROOT / "hapticd"))
    ]
    assert not missing


def test_every_package_stands_in_the_overview(layers: ModuleType) -> None:
    page = (ROOT / "docs" / "OVERVIEW.md").read_text()
    assert not [name for name in layers.imports() if f"`{name}`" not in page]


def test_drawing_of_the_layers_is_that_of_the_imports(layers: ModuleType) -> None:
    """When this fails: `python docs/generate.py` draws it anew."""
    assert layers.DRAWING.read_text() == layers.drawing()


def test_drawing_leaves_out_what_a_longer_way_implies(
    layers: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {"cli": {"client", "errors"}, "client": {"errors"}, "errors": set()}
    monkeypatch.setattr(layers, "imports", lambda: {k: frozenset(v) for k, v in found.items()})
    layers.below.cache_clear()
    assert layers.nearest("cli") == ["client"]
    assert "imports client<" in layers.drawing()
    layers.below.cache_clear()


def test_simulated_board_page_lists_every_trait_and_injection(site: Path) -> None:
    text = page(site, "simulated-board.md")
    names = [
        *Simulation.model_fields,
        *Touch.model_fields,
        *Hand.model_fields,
        *OUT_FAULTS,
        *IN_FAULTS,
    ]
    missing = [name for name in names if f"| `{name}` |" not in text]
    assert missing == ["injections", "touch", "hands"]


SAFETY = (Path(__file__).parents[1] / "docs" / "safety.md").read_text()
SHOWN = re.findall(r"`(test_\w+\.py)::(test_\w+)`", SAFETY)


@pytest.mark.parametrize(("file", "test"), sorted(set(SHOWN)))
def test_every_promise_is_shown_by_a_test_that_exists(file: str, test: str) -> None:
    source = (Path(__file__).parent / file).read_text()
    assert re.search(rf"^def {test}\(", source, re.MULTILINE)


def test_every_promise_names_a_test() -> None:
    rows = [line for line in SAFETY.splitlines() if line.startswith("| ") and "---" not in line][1:]
    assert rows
    assert all(re.search(r"`test_\w+\.py::test_\w+` \|$", row) for row in rows)

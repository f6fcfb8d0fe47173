"""Fetching logs: from a folder, from git repositories, and everything that may be wrong. No network is used."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

from ur5_twin.errors import FetchError
from ur5_twin.fetch import fetch, load_manifest

NAMES = ("Movement_No1", "Movement_No2")
FILES = {
    "Movement_No1/csv_files/log_q_actual.csv": b"0.000000, 1.0\n0.008000, 1.1\n",
    "Movement_No1/csv_files/start_time.csv": b"1386689097.8\r\n",
    "Movement_No2/csv_files/log_q_actual.csv": b"",
}
LICENCE = b"Apache License\n"
FOLDER = "Model C/RecordedData"

needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def _entry(content: bytes) -> str:
    return f'{{ size = {len(content)}, sha256 = "{hashlib.sha256(content).hexdigest()}" }}'


def _write_manifest(path: Path, commit: str, repository: str) -> Path:
    movements = "".join(
        f'[[movement]]\nname = "{name}"\nwhat = "a test"\n[movement.files]\n'
        + "".join(f'"{p.removeprefix(name + "/")}" = {_entry(c)}\n' for p, c in FILES.items() if p.startswith(name))
        for name in NAMES
    )
    path.write_text(
        f'name = "toy"\ntitle = "A toy"\nrepository = "{repository}"\nfolder = "{FOLDER}"\ncommit = "{commit}"\n'
        f'licence = "Apache-2.0"\nlicence_file = {_entry(LICENCE)}\n{movements}'
    )
    return path


def _write_files(root: Path) -> Path:
    for name, content in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    return root


def _git(repository: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=test", "-c", "user.email=test@example.invalid", "-c", "commit.gpgsign=false")
    command = ["git", "-C", str(repository), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A plain folder of the logs."""
    root = _write_files(tmp_path / "logs")
    (root / "LICENSE.txt").write_bytes(LICENCE)
    return root


@pytest.fixture
def repository(tmp_path: Path) -> tuple[Path, str]:
    """A git repository whose pinned commit is not its newest, and that newest commit has other files."""
    root = tmp_path / "repository"
    _write_files(root / FOLDER)
    (root / "LICENSE").write_bytes(LICENCE)
    _git(root, "init", "--quiet")
    # Attributes that change line ends in a checkout must not change what is fetched.
    (root / ".gitattributes").write_text("*.csv text eol=crlf\n")
    _git(root, "add", "--all", "--force")
    # The blob with "\\r\\n" in it must be stored as it is.
    blob = _git(root, "hash-object", "-w", "--no-filters", f"{FOLDER}/Movement_No1/csv_files/start_time.csv")
    _git(root, "update-index", "--cacheinfo", f"100644,{blob},{FOLDER}/Movement_No1/csv_files/start_time.csv")
    _git(root, "commit", "--quiet", "-m", "logs")
    commit = _git(root, "rev-parse", "HEAD")
    shutil.rmtree(root / FOLDER)
    _git(root, "add", "--all")
    _git(root, "commit", "--quiet", "-m", "gone")
    return root, commit


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    return _write_manifest(tmp_path / "toy.toml", "0" * 40, "https://example.invalid/toy")


def _assert_fetched(folder: Path, out: Path) -> None:
    assert folder == out / "toy"
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert found == {"LICENSE.txt": LICENCE, **FILES}
    assert [p.name for p in out.iterdir()] == ["toy"]


# ---------------------------------------------------------------- from a folder


@pytest.mark.parametrize("inner", ["", "toy", FOLDER])
def test_folder(logs: Path, manifest: Path, tmp_path: Path, inner: str) -> None:
    source = logs
    if inner:
        source = tmp_path / "elsewhere"
        (source / inner).parent.mkdir(parents=True)
        logs.rename(source / inner)
    seen: list[tuple[int, int]] = []
    folder = fetch("toy", source, tmp_path / "out", manifest, lambda done, of: seen.append((done, of)))
    _assert_fetched(folder, tmp_path / "out")
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_again_checks_and_keeps(logs: Path, manifest: Path, tmp_path: Path) -> None:
    folder = fetch("toy", logs, tmp_path / "out", manifest)
    (folder / "my_notes.txt").write_text("mine")
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    # The source is not needed any more.
    assert fetch("toy", tmp_path / "gone", tmp_path / "out", manifest) == folder
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before


@pytest.mark.parametrize("damage", ["change", "cut", "remove"])
def test_damaged_copy(logs: Path, manifest: Path, tmp_path: Path, damage: str) -> None:
    folder = fetch("toy", logs, tmp_path / "out", manifest)
    file = folder / "Movement_No1/csv_files/log_q_actual.csv"
    if damage == "change":
        file.write_bytes(file.read_bytes().replace(b"1.1", b"1.2"))
    elif damage == "cut":
        file.write_bytes(file.read_bytes()[:-3])
    else:
        file.unlink()
    what = {
        "change": "differs: SHA-256 [0-9a-f]{64}, expected",
        "cut": "differs: 25 bytes, expected 28",
        "remove": "is missing",
    }
    with pytest.raises(FetchError, match=rf"log_q_actual\.csv {what[damage]}.*move .*out/toy away and fetch again"):
        fetch("toy", logs, tmp_path / "out", manifest)


def test_changed_source(logs: Path, manifest: Path, tmp_path: Path) -> None:
    right = hashlib.sha256(FILES["Movement_No1/csv_files/log_q_actual.csv"]).hexdigest()
    (logs / "Movement_No1/csv_files/log_q_actual.csv").write_bytes(b"0.000000, 1.0\n0.008000, 1.2\n")
    with pytest.raises(
        FetchError, match=rf"Movement_No1/csv_files/log_q_actual\.csv differs: SHA-256 .*expected {right}"
    ):
        fetch("toy", logs, tmp_path / "out", manifest)
    assert not (tmp_path / "out").exists()


def test_missing_in_source(logs: Path, manifest: Path, tmp_path: Path) -> None:
    shutil.rmtree(logs / "Movement_No2")
    with pytest.raises(FetchError, match=r"Movement_No2/csv_files/log_q_actual\.csv is missing \(1 of 3 files are\)"):
        fetch("toy", logs, tmp_path / "out", manifest)
    assert not (tmp_path / "out").exists()


def test_licence_comes_along(logs: Path, manifest: Path, tmp_path: Path) -> None:
    (logs / "LICENSE.txt").unlink()
    with pytest.raises(FetchError, match="no licence file"):
        fetch("toy", logs, tmp_path / "out", manifest)
    (logs / "LICENSE").write_bytes(b"another")
    with pytest.raises(FetchError, match=r"LICENSE\.txt differs"):
        fetch("toy", logs, tmp_path / "out", manifest)


def test_folder_of_something_else(manifest: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(FetchError, match=r"empty: holds none of the movements of 'toy' \('Movement_No1', \.\.\.\)"):
        fetch("toy", tmp_path / "empty", tmp_path / "out", manifest)


@pytest.mark.parametrize("source", ["no/such/folder", "--upload-pack=touch x", "toy.toml"])
def test_source_that_is_none(manifest: Path, tmp_path: Path, source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        FetchError, match=r"(no such folder|is a file); give a git URL, a local git repository or a folder"
    ):
        fetch("toy", source, tmp_path / "out", manifest)
    assert not (tmp_path / "x").exists()


# ---------------------------------------------------------------- from git


@needs_git
@pytest.mark.parametrize("how", ["folder", "url", "manifest", "bare"])
def test_git(repository: tuple[Path, str], tmp_path: Path, how: str) -> None:
    root, commit = repository
    source: str | Path | None = root
    if how == "url":
        source = root.as_uri()
    elif how == "manifest":
        source = None
    elif how == "bare":
        source = tmp_path / "bare"
        _git(tmp_path, "clone", "--quiet", "--bare", str(root), str(source))
    manifest = _write_manifest(tmp_path / "toy.toml", commit, root.as_uri())
    _assert_fetched(fetch("toy", source, tmp_path / "out", manifest), tmp_path / "out")


@needs_git
def test_server_that_gives_no_single_commit(repository: tuple[Path, str], tmp_path: Path, monkeypatch) -> None:
    """In version 0 of its protocol git refuses to serve a commit that no branch ends in: all is fetched then."""
    root, commit = repository
    for key, value in {"COUNT": "1", "KEY_0": "protocol.version", "VALUE_0": "0"}.items():
        monkeypatch.setenv(f"GIT_CONFIG_{key}", value)
    manifest = _write_manifest(tmp_path / "toy.toml", commit, root.as_uri())
    _assert_fetched(fetch("toy", None, tmp_path / "out", manifest), tmp_path / "out")


@needs_git
def test_commit_not_in_the_repository(repository: tuple[Path, str], manifest: Path, tmp_path: Path) -> None:
    with pytest.raises(FetchError, match=r"commit 0{40} is not in this repository"):
        fetch("toy", repository[0], tmp_path / "out", manifest)
    assert not (tmp_path / "out").exists()


@needs_git
def test_file_not_in_the_commit(repository: tuple[Path, str], tmp_path: Path) -> None:
    root = repository[0]
    manifest = _write_manifest(tmp_path / "toy.toml", _git(root, "rev-parse", "HEAD"), root.as_uri())
    with pytest.raises(FetchError, match=r"Movement_No1/csv_files/log_q_actual\.csv is missing \(3 of 3 files are\)"):
        fetch("toy", None, tmp_path / "out", manifest)


@needs_git
def test_no_network(manifest: Path, tmp_path: Path) -> None:
    """The top-level domain 'invalid' has no hosts, by RFC 2606."""
    with pytest.raises(FetchError, match=r"https://example\.invalid/toy: git cannot fetch it .*is the network up"):
        fetch("toy", None, tmp_path / "out", manifest)
    assert not (tmp_path / "out").exists()


def test_no_git(manifest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FetchError, match=r"git is not installed.*install it, or give a folder"):
        fetch("toy", None, tmp_path / "out", manifest)


# ---------------------------------------------------------------- manifests


def test_unknown_collection() -> None:
    with pytest.raises(FetchError, match=r"unknown collection of logs 'kufieta'.*did you mean 'kufieta2014'"):
        fetch("kufieta")


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (("title =", "titel ="), "titel"),
        ('folder = "', "toy.toml: not a manifest"),
        (("csv_files/start_time", "../../start_time"), "leads out of the collection's folder"),
        (('name = "toy"', 'name = ".."'), "matching regex"),
    ],
)
def test_wrong_manifest(manifest: Path, change: tuple[str, str] | str, what: str) -> None:
    old, new = (change, "") if isinstance(change, str) else change
    manifest.write_text(manifest.read_text().replace(old, new, 1))
    with pytest.raises(FetchError, match=what):
        load_manifest("toy", manifest)


def test_the_manifest_that_ships(lab_logs: Path, tmp_path: Path) -> None:
    """It describes the logs that are here: all ten movements pass through a fetch."""
    manifest = load_manifest("kufieta2014")
    assert len(manifest.movement) == 10
    assert manifest.commit == "dce0de88e75fc6af2a6336d75917244832c1a15e"
    assert manifest.repository == "https://github.com/kkufieta/ur5_modeling_force_estimate"
    folder = fetch("kufieta2014", lab_logs, tmp_path)
    assert (folder / "LICENSE.txt").is_file()
    copied = sorted(p.relative_to(folder) for p in folder.rglob("*.csv"))
    assert copied == sorted(Path(path) for path in manifest.files())

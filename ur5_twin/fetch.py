"""Fetching public logs of real robots: out of a git repository at a pinned commit, or a local copy, every file checked.

What is to be fetched stands in a manifest, ``replay/<name>.toml``: where it comes from, its licence, and the size and
SHA-256 of every file.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from shutil import which
from typing import Annotated

import msgspec

from ur5_twin.errors import FetchError, unknown
from ur5_twin.resources import data_dir

#: Called with the number of files done and the number of all files.
Progress = Callable[[int, int], object]
_LICENCE = "LICENSE.txt"
#: What the licence is called where the logs come from.
_LICENCE_NAMES = (_LICENCE, "LICENSE", "LICENSE.md", "LICENCE", "LICENCE.txt", "COPYING")
#: Where fetch runs inside a git operation (a hook, say), its repository must not be taken for ours.
_OF_ANOTHER_REPOSITORY = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_OBJECT_DIRECTORY", "GIT_COMMON_DIR")
#: A transfer slower than this many bytes per second for this many seconds is given up.
_SLOWEST, _PATIENCE = 1000, 60


class FileEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a file must be."""

    size: Annotated[int, msgspec.Meta(ge=0)]
    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class Movement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One run: a folder of files, by their paths in it."""

    name: str
    what: str
    files: dict[str, FileEntry]


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The layout of ``replay/<name>.toml``.

    Attributes:
        name: of the collection; the folder it is put in.
        title: for people.
        repository: git URL.
        folder: of the movements in the repository.
        commit: full hash.
        licence: SPDX identifier.
        licence_file: what the licence's text must be.
        movement: the runs.
    """

    name: Annotated[str, msgspec.Meta(pattern="^[A-Za-z0-9_-]+$")]
    title: str
    repository: str
    folder: str
    commit: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{40}$")]
    licence: str
    licence_file: FileEntry
    movement: tuple[Movement, ...]

    def files(self) -> dict[str, FileEntry]:
        """Path below the collection's folder -> what the file must be; the licence is not among them."""
        return {f"{m.name}/{path}": entry for m in self.movement for path, entry in m.files.items()}


def fetch(
    name: str = "kufieta2014",
    source: str | Path | None = None,
    out: Path | str = Path("lab_logs"),
    manifest: Path | str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Fetch a collection of logs to ``out/<name>`` and check every file.

    The folder appears in one piece, after every checksum was right. One that is there already is checked and kept.

    Args:
        name: of a manifest that ships.
        source: another git URL, a local git repository, or a folder that holds the movements. Default: the manifest's
            repository.
        out: folder to put the collection's folder in.
        manifest: a manifest's path, instead of one that ships.
        progress: called after each file.

    Returns:
        The collection's folder.

    Raises:
        FetchError: unknown name, wrong manifest, no git, no network, the commit or a file is not in the source, a
            checksum differs, or the folder is there and damaged.
    """
    wanted = load_manifest(name, manifest)
    target = Path(out) / wanted.name
    was_there = target.parent.exists()
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            _verify_present(wanted, target, progress)
            return target
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{wanted.name}-", dir=target.parent) as temporary:
            made = Path(temporary) / wanted.name
            made.mkdir()
            origin = _open(wanted, source, Path(temporary) / "git")
            _copy(wanted, origin, made, progress)
            made.rename(target)
    except OSError as error:
        raise FetchError(f"{error.filename or target}: {error.strerror or error}") from None
    finally:
        if not was_there and not target.exists():
            # What failed leaves nothing behind, not even the folder it was to go into.
            with contextlib.suppress(OSError):
                target.parent.rmdir()
    return target


def load_manifest(name: str, path: Path | str | None = None) -> Manifest:
    """A manifest that ships, by name, or one by its path.

    Raises:
        FetchError: there is none, or it is not in the manifest's layout.
    """
    if path is None:
        known = {p.stem: p for p in data_dir("replay").glob("*.toml")}
        if name not in known:
            raise FetchError(unknown("collection of logs", name, known))
        path = known[name]
    try:
        manifest = msgspec.toml.decode(Path(path).read_bytes(), type=Manifest)
    except OSError as error:
        raise FetchError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FetchError(f"{path}: not a manifest ({error})") from None
    for file in manifest.files():
        parts = PurePosixPath(file).parts
        if ".." in parts or file.startswith("/") or "\n" in file:
            raise FetchError(f"{path}: '{file}' leads out of the collection's folder")
    return manifest


# ---------------------------------------------------------------- where the files come from


@dataclass(frozen=True)
class _Origin:
    """A source whose files can be had.

    Attributes:
        label: for messages.
        contents: (path, bytes) in any order, for the wanted paths that are there.
        licence: its text, if it is there.
    """

    label: str
    contents: Iterator[tuple[str, bytes]]
    licence: bytes | None


def _open(wanted: Manifest, source: str | Path | None, scratch: Path) -> _Origin:
    if source is None:
        return _open_git(wanted, wanted.repository, scratch)
    local = Path(source).expanduser()
    if not local.exists():
        if isinstance(source, Path) or not _looks_like_url(source):
            raise FetchError(
                f"{source}: no such folder; give a git URL, a local git repository or a folder of the logs"
            )
        return _open_git(wanted, str(source), scratch)
    if not local.is_dir():
        raise FetchError(f"{source}: is a file; give a git URL, a local git repository or a folder of the logs")
    if (local / ".git").exists() or ((local / "HEAD").is_file() and (local / "objects").is_dir()):
        return _open_git(wanted, str(local.resolve()), scratch)
    return _open_folder(wanted, local)


def _looks_like_url(source: str) -> bool:
    """``https://...``, ``file://...``, ``git@host:path``; an option of git is none."""
    return not source.startswith("-") and ("://" in source or ":" in source.split("/", 1)[0])


def _open_folder(wanted: Manifest, folder: Path) -> _Origin:
    for root in (folder, folder / wanted.name, folder / wanted.folder):
        if any((root / movement.name).is_dir() for movement in wanted.movement):
            break
    else:
        raise FetchError(
            f"{folder}: holds none of the movements of '{wanted.name}' ('{wanted.movement[0].name}', ...); "
            "give the folder they are in"
        )
    licences = [place / name for place in dict.fromkeys((root, folder)) for name in _LICENCE_NAMES]
    texts = [path.read_bytes() for path in licences if path.is_file()]
    contents = ((path, (root / path).read_bytes()) for path in wanted.files() if (root / path).is_file())
    return _Origin(str(folder), contents, _best_licence(wanted, texts))


def _open_git(wanted: Manifest, url: str, scratch: Path) -> _Origin:
    if which("git") is None:
        raise FetchError(
            "git is not installed, and it is needed to fetch the logs: install it, "
            "or give a folder that holds them already (--from FOLDER)"
        )
    scratch.mkdir()
    _git(scratch, "init", "--quiet", "--bare")
    # Only the pinned commit, where the server lets one ask for it; else everything.
    shallow = _git(scratch, "fetch", "--quiet", "--no-tags", "--depth=1", "--", url, wanted.commit, check=False)
    if shallow.returncode:
        full = _git(scratch, "fetch", "--quiet", "--", url, "+refs/*:refs/source/*", check=False)
        if full.returncode:
            raise FetchError(
                f"{url}: git cannot fetch it ({_last_line(full.stderr)}); is the network up and the URL right?"
            )
    if _git(scratch, "cat-file", "-e", f"{wanted.commit}^{{commit}}", check=False).returncode:
        raise FetchError(f"{url}: commit {wanted.commit} is not in this repository; give one that has it")
    licences = {name: name for name in _LICENCE_NAMES}
    texts = list(dict(_blobs(scratch, wanted.commit, licences)).values())
    paths = {path: f"{wanted.folder}/{path}" for path in wanted.files()}
    return _Origin(
        f"{url} at {wanted.commit[:12]}", _blobs(scratch, wanted.commit, paths), _best_licence(wanted, texts)
    )


def _best_licence(wanted: Manifest, texts: list[bytes]) -> bytes | None:
    right = [text for text in texts if hashlib.sha256(text).hexdigest() == wanted.licence_file.sha256]
    return next(iter(right or texts), None)


def _git(
    repository: Path, *arguments: str, check: bool = True, stdin: bytes = b""
) -> subprocess.CompletedProcess[bytes]:
    """Run git without questions to the user."""
    slow = ("-c", f"http.lowSpeedLimit={_SLOWEST}", "-c", f"http.lowSpeedTime={_PATIENCE}")
    environment = {key: value for key, value in os.environ.items() if key not in _OF_ANOTHER_REPOSITORY}
    environment |= {"GIT_TERMINAL_PROMPT": "0", "LC_ALL": "C"}
    try:
        done = subprocess.run(
            ["git", *slow, "-C", str(repository), *arguments],
            input=stdin,
            capture_output=True,
            env=environment,
            check=False,
        )
    except OSError as error:
        raise FetchError(f"git cannot be run ({error.strerror or error})") from None
    if check and done.returncode:
        raise FetchError(f"git {arguments[0]} failed ({_last_line(done.stderr)})")
    return done


def _last_line(stderr: bytes) -> str:
    lines = [line.strip() for line in stderr.decode(errors="replace").splitlines() if line.strip()]
    fatal = [line for line in lines if line.startswith(("fatal:", "error:"))]
    return (fatal or lines or ["no reason given"])[-1]


def _blobs(repository: Path, commit: str, paths: Mapping[str, str]) -> Iterator[tuple[str, bytes]]:
    """Contents of files at a commit, byte by byte as they are in it; what is not there is passed over."""
    asked = "".join(f"{commit}:{path}\n" for path in paths.values()).encode()
    answer = memoryview(_git(repository, "cat-file", "--batch", stdin=asked).stdout)
    at = 0
    for key in paths:
        end = at + bytes(answer[at : at + 4096]).index(b"\n")
        head = bytes(answer[at:end]).split()
        at = end + 1
        if len(head) == 3 and head[1] in (b"blob", b"tree"):
            size = int(head[2])
            if head[1] == b"blob":
                yield key, bytes(answer[at : at + size])
            at += size + 1


# ---------------------------------------------------------------- checking and copying


def _copy(wanted: Manifest, origin: _Origin, made: Path, progress: Progress | None) -> None:
    files = wanted.files()
    if origin.licence is None:
        raise FetchError(f"{origin.label}: no licence file ({', '.join(_LICENCE_NAMES)}); the logs come with it")
    _check(origin.licence, wanted.licence_file, f"{origin.label}: {_LICENCE}")
    (made / _LICENCE).write_bytes(origin.licence)
    missing = dict.fromkeys(files)
    for path, content in origin.contents:
        _check(content, files[path], f"{origin.label}: {path}")
        (made / path).parent.mkdir(parents=True, exist_ok=True)
        (made / path).write_bytes(content)
        del missing[path]
        if progress is not None:
            progress(len(files) - len(missing), len(files))
    if missing:
        raise FetchError(
            f"{origin.label}: {next(iter(missing))} is missing ({len(missing)} of {len(files)} files are); "
            "is this the repository of the manifest?"
        )


def _check(content: bytes, entry: FileEntry, label: str) -> None:
    if len(content) != entry.size:
        raise FetchError(f"{label} differs: {len(content):,} bytes, expected {entry.size:,}")
    found = hashlib.sha256(content).hexdigest()
    if found != entry.sha256:
        raise FetchError(f"{label} differs: SHA-256 {found}, expected {entry.sha256}")


def _verify_present(wanted: Manifest, target: Path, progress: Progress | None) -> None:
    files = {_LICENCE: wanted.licence_file, **wanted.files()}
    for done, (path, entry) in enumerate(files.items()):
        if not (target / path).is_file():
            raise FetchError(f"{target / path} is missing: {_move_away(target)}")
        try:
            _check((target / path).read_bytes(), entry, str(target / path))
        except FetchError as error:
            raise FetchError(f"{error}: {_move_away(target)}") from None
        if progress is not None and done:
            progress(done, len(files) - 1)


def _move_away(target: Path) -> str:
    return f"the copy is damaged or not what it should be; move {target} away and fetch again"

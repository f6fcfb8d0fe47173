"""MuJoCo from compiled code: its functions by name, and the few numbers of its memory that a stepping loop needs.

A loop that calls ``mj_step`` from Python spends as long in Python as in the engine. Here the loop is compiled by numba,
calls the engine's C functions itself and reads the engine's memory through arrays, so that a closed-loop tick costs
little more than the bare steps in it, and runs without the interpreter's lock: many cells run on many threads.

Where a field lies in MuJoCo's structs follows from MuJoCo's own description of them (``mujoco.introspect``) and is
checked against the addresses its Python bindings give, so that another version cannot be read wrongly in silence.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from llvmlite import binding
from mujoco.introspect import ast_nodes, structs
from numba import types

from ur5_twin.errors import TwinError

_FOLDER = Path(mujoco.__file__).parent
_LIBRARY = next((p for p in sorted(_FOLDER.iterdir()) if p.name.startswith(("libmujoco", "mujoco.dll"))), None)
if _LIBRARY is None:
    raise TwinError(f"MuJoCo's library is not in {_FOLDER}; install the mujoco wheel again")
binding.load_library_permanently(str(_LIBRARY))

#: ``mj_step(model, data)`` for compiled code; both arguments are addresses (``Engine.model``, ``Engine.data``).
mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
#: ``mj_contactForce(model, data, contact, result)``: result is the address of six doubles, in the contact's frame.
mj_contact_force = types.ExternalFunction(
    "mj_contactForce", types.void(types.intp, types.intp, types.intc, types.CPointer(types.float64))
)

_SCALARS = {
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "mjtNum": ctypes.c_double,
    "mjtByte": ctypes.c_ubyte,
    "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
    "size_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "uintptr_t": ctypes.c_size_t,
    "unsigned int": ctypes.c_uint,
}


class Engine(NamedTuple):
    """A model and its data for compiled code: pass it on as one argument, keep model and data alive beside it.

    Attributes:
        model, data: addresses of mjModel and mjData.
        timestep: (1,) s, may be written.
        ncon: (1,) number of contacts that the last step found.
        contacts: (n, 73) and more, the contacts' memory as doubles, one row a contact; see ``CONTACT_*``.
        contact_geoms: the same memory as int32.
        qpos, qvel, qacc, ctrl, applied: (6,) each; ``applied`` is qfrc_applied.
        body_wrench: (nbody, 6) force and torque on each body at its mass centre, world axes (xfrc_applied).
        body_position, body_center: (nbody, 3) origins and mass centres, world.
        body_rotation: (nbody, 9) bodies' axes, world.
        axes, anchors: (6, 3) the joints' lines, world.
        flange: (3,) the flange's origin, world.
        geom_body: (ngeom,) body of each geom.
    """

    model: int
    data: int
    timestep: np.ndarray
    ncon: np.ndarray
    contacts: np.ndarray
    contact_geoms: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    qacc: np.ndarray
    ctrl: np.ndarray
    applied: np.ndarray
    body_wrench: np.ndarray
    body_position: np.ndarray
    body_center: np.ndarray
    body_rotation: np.ndarray
    axes: np.ndarray
    anchors: np.ndarray
    flange: np.ndarray
    geom_body: np.ndarray


def connect(model: mujoco.MjModel, data: mujoco.MjData) -> Engine:
    """Describe a model and its data to compiled code.

    Raises:
        TwinError: this version of MuJoCo keeps its memory otherwise than it says.
    """
    at = _offsets("mjData")
    n = max(1, int(data.narena) // ctypes.sizeof(_struct("mjContact")))
    rows = min(n, _MOST_CONTACTS)
    contact = _read_pointer(data._address + at["contact"])
    qpos = _read_pointer(data._address + at["qpos"])
    probe = ctypes.c_int.from_address(data._address + at["ncon"]).value
    if qpos != data.qpos.ctypes.data or probe != data.ncon or contact != _read_pointer(data._address + at["arena"]):
        raise TwinError(f"mujoco {mujoco.__version__} lays out mjData otherwise than it says; try the pinned version")
    timestep = _view(model._address + _offsets("mjModel")["opt"], np.float64, (1,))
    if timestep[0] != model.opt.timestep:
        raise TwinError(f"mujoco {mujoco.__version__} lays out mjModel otherwise than it says; try the pinned version")
    size = ctypes.sizeof(_struct("mjContact"))
    return Engine(
        model=model._address,
        data=data._address,
        timestep=timestep,
        ncon=_view(data._address + at["ncon"], np.int32, (1,)),
        contacts=_view(contact, np.float64, (rows, size // 8)),
        contact_geoms=_view(contact, np.int32, (rows, size // 4)),
        qpos=data.qpos[:6],
        qvel=data.qvel[:6],
        qacc=data.qacc[:6],
        ctrl=data.ctrl[:6],
        applied=data.qfrc_applied[:6],
        body_wrench=data.xfrc_applied,
        body_position=data.xpos,
        body_center=data.xipos,
        body_rotation=data.xmat,
        axes=data.xaxis[:6],
        anchors=data.xanchor[:6],
        flange=data.site("flange").xpos,
        geom_body=model.geom_bodyid,
    )


def _offsets(name: str) -> dict[str, int]:
    struct = _struct(name)
    return {field: getattr(struct, field).offset for field, *_ in struct._fields_}


_KNOWN: dict[str, Any] = {}
#: Of the model's struct nothing behind this field is needed (nor are the nameless structs in it).
_LAST_NEEDED = ("mjModel", "opt")


def _struct(name: str) -> Any:
    """A ctypes struct with the layout of one of MuJoCo's, by MuJoCo's description."""
    if name not in _KNOWN:
        fields = []
        described: Any = structs.STRUCTS[name]
        for field in described.fields:
            fields.append((field.name, _ctype(field.type)))
            if (name, field.name) == _LAST_NEEDED:
                break
        _KNOWN[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return _KNOWN[name]


def _ctype(kind: Any) -> Any:
    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        inner = _ctype(kind.inner_type)
        for extent in reversed(kind.extents):
            inner = inner * extent
        return inner
    if kind.name in _SCALARS:
        return _SCALARS[kind.name]
    if kind.name in structs.STRUCTS:
        return _struct(kind.name)
    return ctypes.c_int  # an enumeration


def _read_pointer(address: int) -> int:
    return ctypes.c_void_p.from_address(address).value or 0


def _view(address: int, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory: Any = (ctypes.c_ubyte * count).from_address(address)
    return np.frombuffer(memory, dtype=dtype).reshape(shape)


#: No arm touches its cell in as many points.
_MOST_CONTACTS = 200
_CONTACT = _offsets("mjContact")
#: Columns of ``Engine.contacts``: penetration (negative) in m, position (3), frame (9) with the normal first, and of
#: ``Engine.contact_geoms``: the two geoms.
CONTACT_DIST = _CONTACT["dist"] // 8
CONTACT_POS = _CONTACT["pos"] // 8
CONTACT_FRAME = _CONTACT["frame"] // 8
CONTACT_GEOMS = _CONTACT["geom"] // 4

"""Contacts of mecanum wheels that have one tyre: friction acts along the roller that touches, and hardly across it.

A mecanum wheel bears rollers at 45 degrees to its axle. The roller that touches passes on a force along its axis, as
rubber does; across its axis it turns, and passes on no more than the friction of its bearing. Here a wheel is one body
with one tyre, and its contact has friction of that kind. With r from the wheel's centre to the contact, y the axle, and
t = r x y normalised, the axis of the roller there is t + s y, where s is +1 or -1 by the side to which rollers turn. It
follows the place of the contact, on an incline and at an edge as well.

MuJoCo looks a collision function up in a table, ``mjCOLLISIONFUNC``, for each pair of geoms. :func:`install` replaces
those of spheres and ellipsoids by functions that call MuJoCo's own, and then take the contacts of tyres: these are
added with the axis of the roller as their first tangent, and a coefficient of friction for each tangent. Normal, depth
and place stay as MuJoCo found them, and the solver treats them as any contact. So ``mj_step``, ``mj_forward``, rollouts
and viewers in this process find the same contacts. Geoms that are not marked as tyres, by the ``user`` numbers of
craftsim/mjcf/car.py, are left alone. A process that has not called :func:`install` sees tyres with equal friction in
all directions.

The layout of MuJoCo's structures comes from its own description, ``mujoco.introspect``, and is checked.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from typing import Any, Final

import llvmlite.binding as llvm
import mujoco
import numpy as np
from llvmlite import ir
from mujoco.introspect import ast_nodes, structs
from numba.core import config, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import address_of, compiled
from craftsim.mjcf.car import ACROSS, N_USER, SIDE, TYRE
from craftsim.models.library import LIBRARY

_STEEPEST: Final = 0.5
"""Sine of the least angle between axle and contact: nearer to the axle the wheel's flank touches, not a roller."""
_SHAPES: Final = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
_N_TYPES: Final = int(mujoco.mjtGeom.mjNGEOMTYPES)
_TABLE: Final = (ctypes.c_void_p * (_N_TYPES * _N_TYPES)).in_dll(LIBRARY, "mjCOLLISIONFUNC")

_NUMBERS: Final[dict[str, Any]] = {
    "mjtNum": ctypes.c_double,
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "mjtSize": ctypes.c_int64,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "int": ctypes.c_int,
    "unsigned int": ctypes.c_uint,
    "mjtBool": ctypes.c_bool,
    "mjtByte": ctypes.c_uint8,
    "char": ctypes.c_char,
}


def _kind(of: Any) -> Any:
    """Return the type in ctypes of a member of one of MuJoCo's structures."""
    if isinstance(of, ast_nodes.AnonymousStructDecl):
        members = [(member.name, _kind(member.type)) for member in of.fields]
        return type("Anonymous", (ctypes.Structure,), {"_fields_": members})
    if isinstance(of, ast_nodes.ArrayType):
        kind = _kind(of.inner_type)
        for length in reversed(of.extents):
            kind = kind * length
        return kind
    if isinstance(of, ast_nodes.PointerType):
        return ctypes.c_void_p
    name = re.sub(r"^(struct )?(\w+?)_?$", r"\2", of.name)
    if name in _NUMBERS:
        return _NUMBERS[name]
    if name in structs.STRUCTS:
        return _structure(name)
    # An enumeration.
    return ctypes.c_int


@cache
def _structure(name: str) -> Any:
    members = [(member.name, _kind(member.type)) for member in structs.STRUCTS[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": members})


_MODEL: Final = _structure("mjModel")
_DATA: Final = _structure("mjData")
_CONTACT: Final = _structure("mjContact")
_FOUND: Final = _structure("mjPreContact")


def _place(structure: Any, member: str, size: int) -> int:
    """Return where a member of a structure begins, counted in words of a size."""
    offset: int = getattr(structure, member).offset
    return offset // size


_N_USER_AT: Final = _place(_MODEL, "nuser_geom", 8)
_USER: Final = _place(_MODEL, "geom_user", 8)
_FRICTION: Final = _place(_MODEL, "geom_friction", 8)
_PRIORITY: Final = _place(_MODEL, "geom_priority", 8)
_WEIGHT: Final = _place(_MODEL, "geom_solmix", 8)
_SOLREF: Final = _place(_MODEL, "geom_solref", 8)
_SOLIMP: Final = _place(_MODEL, "geom_solimp", 8)
_POSITION: Final = _place(_DATA, "geom_xpos", 8)
_AXES: Final = _place(_DATA, "geom_xmat", 8)
_FOUND_SIZE: Final = ctypes.sizeof(_FOUND) // 8
_FOUND_DISTANCE: Final = _place(_FOUND, "dist", 8)
_FOUND_POSITION: Final = _place(_FOUND, "pos", 8)
_FOUND_NORMAL: Final = _place(_FOUND, "normal", 8)
_CONTACT_SIZE: Final = ctypes.sizeof(_CONTACT) // 8
_CONTACT_DISTANCE: Final = _place(_CONTACT, "dist", 8)
_CONTACT_POSITION: Final = _place(_CONTACT, "pos", 8)
_CONTACT_FRAME: Final = _place(_CONTACT, "frame", 8)
_CONTACT_FRICTION: Final = _place(_CONTACT, "friction", 8)
_CONTACT_SOLREF: Final = _place(_CONTACT, "solref", 8)
_CONTACT_SOLIMP: Final = _place(_CONTACT, "solimp", 8)
_CONTACT_DIM: Final = _place(_CONTACT, "dim", 4)
_CONTACT_GEOM1: Final = _place(_CONTACT, "geom1", 4)
_CONTACT_GEOM2: Final = _place(_CONTACT, "geom2", 4)
_CONTACT_GEOMS: Final = _place(_CONTACT, "geom", 4)
_CONTACT_FLEX: Final = _place(_CONTACT, "flex", 4)
_CONTACT_ELEMENT: Final = _place(_CONTACT, "elem", 4)
_CONTACT_VERTEX: Final = _place(_CONTACT, "vert", 4)
_CONTACT_EXCLUDE: Final = _place(_CONTACT, "exclude", 4)
_CONTACT_ROWS: Final = _place(_CONTACT, "efc_address", 4)

if config.DISABLE_JIT:
    LIBRARY.mj_addContact.argtypes = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p

    def _add_contact(model: int, data: int, contact: int) -> int:
        full: int = LIBRARY.mj_addContact(model, data, contact)
        return full

    def _pointer(kind: Any) -> Any:
        return lambda address: ctypes.cast(int(address), ctypes.POINTER(kind))

    _doubles = _pointer(ctypes.c_double)
    _words = _pointer(ctypes.c_int64)
    _integers = _pointer(ctypes.c_int32)
else:
    _add_contact = types.ExternalFunction("mj_addContact", types.int32(types.int64, types.int64, types.int64))

    def _pointer(kind: Any) -> Any:
        """Return a function of an address that gives a pointer to numbers of a kind."""
        pointer = types.CPointer(kind)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(pointer))

        @intrinsic
        def cast(typing: Any, address: Any) -> Any:
            return pointer(types.int64), generate

        return cast

    _doubles = _pointer(types.float64)
    _words = _pointer(types.int64)
    _integers = _pointer(types.int32)


@compiled(inline=False)
def _take_tyres(model: int, data: int, found: int, geom1: int, geom2: int, n_found: int, contact: int) -> int:
    """Add the contacts between a tyre and another geom to MuJoCo's; return how many of those found are left.

    Args:
        model: address of the mjModel.
        data: address of the mjData.
        found: address of the contacts that MuJoCo found between two geoms, mjPreContact.
        geom1: the first geom.
        geom2: the second one.
        n_found: how many contacts there are.
        contact: address of an mjContact to be filled in.
    """
    model_words = _words(model)
    n_user = model_words[_N_USER_AT]
    if n_user < N_USER:
        return n_found
    user = _doubles(model_words[_USER])
    if user[geom1 * n_user] == TYRE:
        tyre = geom1
        other = geom2
    elif user[geom2 * n_user] == TYRE:
        tyre = geom2
        other = geom1
    else:
        return n_found
    side = user[tyre * n_user + SIDE]
    across = user[tyre * n_user + ACROSS]
    data_words = _words(data)
    positions = _doubles(data_words[_POSITION])
    axes = _doubles(data_words[_AXES])
    friction = _doubles(model_words[_FRICTION])
    priority = _integers(model_words[_PRIORITY])
    weight = _doubles(model_words[_WEIGHT])
    solref = _doubles(model_words[_SOLREF])
    solimp = _doubles(model_words[_SOLIMP])
    numbers = _doubles(contact)
    integers = _integers(contact)
    contacts = _doubles(found)
    # As MuJoCo combines two geoms: that of the higher priority decides; else the larger friction, and weighted means.
    share = 0.5
    if weight[tyre] + weight[other] > 0.0:
        share = weight[tyre] / (weight[tyre] + weight[other])
    along = max(friction[3 * tyre], friction[3 * other])
    if priority[tyre] > priority[other]:
        share = 1.0
        along = friction[3 * tyre]
    elif priority[tyre] < priority[other]:
        share = 0.0
        along = friction[3 * other]
    axle = (axes[9 * tyre + 1], axes[9 * tyre + 4], axes[9 * tyre + 7])
    n_left = 0
    for number in range(n_found):
        at = number * _FOUND_SIZE
        place = at + _FOUND_POSITION
        normal = at + _FOUND_NORMAL
        # From the wheel's centre to the contact.
        r_x = contacts[place] - positions[3 * tyre]
        r_y = contacts[place + 1] - positions[3 * tyre + 1]
        r_z = contacts[place + 2] - positions[3 * tyre + 2]
        # Along the tread, t = r x y.
        t_x = r_y * axle[2] - r_z * axle[1]
        t_y = r_z * axle[0] - r_x * axle[2]
        t_z = r_x * axle[1] - r_y * axle[0]
        length = (t_x * t_x + t_y * t_y + t_z * t_z) ** 0.5
        distance = (r_x * r_x + r_y * r_y + r_z * r_z) ** 0.5
        if length <= _STEEPEST * distance:
            for word in range(_FOUND_SIZE):
                contacts[n_left * _FOUND_SIZE + word] = contacts[at + word]
            n_left += 1
            continue
        # The roller's axis, in the plane of the contact.
        a_x = t_x / length + side * axle[0]
        a_y = t_y / length + side * axle[1]
        a_z = t_z / length + side * axle[2]
        n_x = contacts[normal]
        n_y = contacts[normal + 1]
        n_z = contacts[normal + 2]
        out = a_x * n_x + a_y * n_y + a_z * n_z
        a_x -= out * n_x
        a_y -= out * n_y
        a_z -= out * n_z
        length = (a_x * a_x + a_y * a_y + a_z * a_z) ** 0.5
        a_x /= length
        a_y /= length
        a_z /= length
        for word in range(_CONTACT_SIZE):
            numbers[word] = 0.0
        numbers[_CONTACT_DISTANCE] = contacts[at + _FOUND_DISTANCE]
        for axis in range(3):
            numbers[_CONTACT_POSITION + axis] = contacts[place + axis]
            numbers[_CONTACT_FRAME + axis] = contacts[normal + axis]
        numbers[_CONTACT_FRAME + 3] = a_x
        numbers[_CONTACT_FRAME + 4] = a_y
        numbers[_CONTACT_FRAME + 5] = a_z
        numbers[_CONTACT_FRAME + 6] = n_y * a_z - n_z * a_y
        numbers[_CONTACT_FRAME + 7] = n_z * a_x - n_x * a_z
        numbers[_CONTACT_FRAME + 8] = n_x * a_y - n_y * a_x
        numbers[_CONTACT_FRICTION] = along
        numbers[_CONTACT_FRICTION + 1] = min(across, along)
        for word in range(2, 5):
            numbers[_CONTACT_FRICTION + word] = friction[3 * tyre + (word + 1) // 2]
        for word in range(2):
            mean = share * solref[2 * tyre + word] + (1.0 - share) * solref[2 * other + word]
            numbers[_CONTACT_SOLREF + word] = mean
        for word in range(5):
            mean = share * solimp[5 * tyre + word] + (1.0 - share) * solimp[5 * other + word]
            numbers[_CONTACT_SOLIMP + word] = mean
        integers[_CONTACT_DIM] = 3
        integers[_CONTACT_GEOM1] = geom1
        integers[_CONTACT_GEOM2] = geom2
        integers[_CONTACT_GEOMS] = geom1
        integers[_CONTACT_GEOMS + 1] = geom2
        for word in range(2):
            integers[_CONTACT_FLEX + word] = -1
            integers[_CONTACT_ELEMENT + word] = -1
            integers[_CONTACT_VERTEX + word] = -1
        # Tyres have no margin: a contact at a distance has no force.
        integers[_CONTACT_EXCLUDE] = contacts[at + _FOUND_DISTANCE] >= 0.0
        integers[_CONTACT_ROWS] = -1
        _add_contact(model, data, contact)
    return n_left


def _entry(module: ir.Module, name: str, original: int, take_tyres: int) -> None:
    """Add a collision function, which calls MuJoCo's own and then takes the contacts of tyres from what that found."""
    word = ir.IntType(64)
    number = ir.IntType(32)
    arguments = [word, word, word, number, number, ir.DoubleType()]
    kind = ir.FunctionType(number, arguments)
    function = ir.Function(module, kind, name)
    builder = ir.IRBuilder(function.append_basic_block())
    model, data, found, geom1, geom2, margin = function.args
    collide = builder.inttoptr(word(original), kind.as_pointer())
    n_found = builder.call(collide, [model, data, found, geom1, geom2, margin])
    result = builder.alloca(word)
    error = builder.alloca(word)
    contact = builder.alloca(ir.ArrayType(word, _CONTACT_SIZE))
    # Functions of numba return a status; the result and an error go to where the first two arguments say.
    taking = ir.FunctionType(number, [word.as_pointer(), word.as_pointer(), *[word] * 7])
    take = builder.inttoptr(word(take_tyres), taking.as_pointer())
    geoms = [builder.sext(geom, word) for geom in (geom1, geom2)]
    rest = [builder.sext(n_found, word), builder.ptrtoint(contact, word)]
    builder.call(take, [result, error, model, data, found, *geoms, *rest])
    builder.ret(builder.trunc(builder.load(result), number))


def _collision_functions() -> dict[int, int]:
    """Return MuJoCo's functions of pairs of shapes of which a tyre can be one, by their places in the table."""
    functions = {}
    for shape in _SHAPES:
        for other in range(_N_TYPES):
            for place in (shape * _N_TYPES + other, other * _N_TYPES + shape):
                address = _TABLE[place]
                if address:
                    functions[place] = address
    return functions


@cache
def install() -> Any:
    """Let MuJoCo, in this process, find contacts of tyres as this module says."""
    _check_layout()
    take_tyres = address_of(_take_tyres, (types.int64,) * 7)
    module = ir.Module()
    originals = _collision_functions()
    for place, original in originals.items():
        _entry(module, f"craftsim_collide_{place}", original, take_tyres)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(str(module)), machine)
    engine.finalize_object()
    for place in originals:
        _TABLE[place] = engine.get_function_address(f"craftsim_collide_{place}")
    return engine


def tyres_of(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the geoms of a model that are tyres."""
    if model.nuser_geom < N_USER:
        return np.zeros(0, np.intp)
    return np.flatnonzero(model.geom_user[:, 0] == TYRE)


def _check_layout() -> None:
    """Raise ImportError where MuJoCo's structures are not as it describes them."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(size=[1.0, 0.0, 0.0], userdata=[TYRE] * N_USER)
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 1.5])
    body.add_freejoint()
    body.add_geom(size=[1.0, 0.0, 0.0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model_there = _MODEL.from_address(model._address)
    data_there = _DATA.from_address(data._address)
    contact_there = _CONTACT.from_address(data_there.contact)
    contact = data.contact[0]
    agree = (
        model_there.nuser_geom == model.nuser_geom,
        model_there.geom_user == model.geom_user.ctypes.data,
        model_there.geom_friction == model.geom_friction.ctypes.data,
        model_there.geom_priority == model.geom_priority.ctypes.data,
        model_there.geom_solmix == model.geom_solmix.ctypes.data,
        model_there.geom_solref == model.geom_solref.ctypes.data,
        model_there.geom_solimp == model.geom_solimp.ctypes.data,
        data_there.geom_xpos == data.geom_xpos.ctypes.data,
        data_there.geom_xmat == data.geom_xmat.ctypes.data,
        contact_there.dist == contact.dist,
        list(contact_there.frame) == contact.frame.tolist(),
        list(contact_there.friction) == contact.friction.tolist(),
        list(contact_there.solref) == contact.solref.tolist(),
        list(contact_there.solimp) == contact.solimp.tolist(),
        contact_there.dim == contact.dim,
        list(contact_there.geom) == contact.geom.tolist(),
        contact_there.exclude == contact.exclude,
        contact_there.efc_address == contact.efc_address,
    )
    if not all(agree):
        raise ImportError(
            f"MuJoCo {mujoco.__version__} lays its structures out otherwise than mujoco.introspect says, which "
            "craftsim needs for the contacts of wheels; install another release: python -m pip install 'mujoco<4'"
        )

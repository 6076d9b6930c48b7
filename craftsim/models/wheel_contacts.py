"""Contacts of mecanum wheels that have one tyre: friction acts along the roller that touches, and hardly across it.

A mecanum wheel bears rollers at 45 degrees to its axle. The roller that touches passes on a force along its axis, as
rubber does; across its axis it turns, and passes on no more than the friction of its bearing. Here a wheel is one body
with one tyre, and its contact has friction of that kind. With r from the wheel's centre to the contact, y the axle, and
t = r x y normalised, the axis of the roller there is t + s y, where s is +1 or -1 by the side to which rollers turn. It
follows the place of the contact, on an incline and at an edge as well.

MuJoCo looks a collision function up in a table, ``mjCOLLISIONFUNC``, for each pair of geoms. :func:`install` replaces
those of spheres by functions that call MuJoCo's own, and then take the contacts of tyres: these are added with the axis
of the roller as their first tangent, a coefficient of friction for each tangent, and friction as stiff as that of the
harder of the two geoms (``solreffriction``). Normal, depth, place and all other parameters are as MuJoCo has them, and
the solver treats them as any contact. So ``mj_step``, ``mj_forward``, rollouts,
pools of threads and viewers in this process find the same contacts.

Distances (``mj_geomDistance``, and sensors of distance) are MuJoCo's own. But that of a sphere whose centre lies in a
mesh or an ellipsoid is found another way, for ``mj_geomDistance`` knows MuJoCo's function by its address. An explicit
pair (``<pair>``) keeps its parameters: it has itself a coefficient of friction for each tangent, of which the first
becomes the roller's axis. Where two tyres touch, the rollers of the first decide.

A sphere is wider than a wheel: what would touch it beside the tread is left out.

Geoms that are not marked as tyres, by the ``user`` numbers of craftsim/mjcf/car.py, are left alone; a marked geom of
another shape is none. A process that has not called :func:`install` sees tyres with equal friction in all directions.

MuJoCo's solver pushes a contact that slides at a speed v with a coefficient mu apart, as if its normal were damped at a
speed of mu v. Wheels slide across their rollers in every motion to a side, and the friction of a bearing would lift
them by several times what they give way by at rest: they would hop. So the friction across is that of the bearing up to
some 30 mm/s, and beyond as much smaller as the wheel slides faster. It holds a wheel that stands, and takes next to
nothing from one that drives.

The layout of MuJoCo's structures comes from its own description, ``mujoco.introspect``, and is checked.
"""

from __future__ import annotations

import ctypes
import re
import threading
from functools import cache
from typing import Any, Final

import mujoco
import numpy as np
from llvmlite import ir
from mujoco.introspect import ast_nodes, structs
from numba.core import config, types
from numpy.typing import NDArray

from craftsim.compiled.jit import address_of, compiled
from craftsim.mjcf.car import ACROSS, HALF_WIDTH, N_USER, SIDE, TYRE
from craftsim.mjcf.parameters import GRAVITY
from craftsim.models.library import (
    LIBRARY,
    bytes_at,
    doubles_at,
    integers_at,
    machine_code,
    words_at,
)

_LIFT: Final = 0.25
"""By what share of its depth at rest friction across may lift a wheel."""
_SPHERE: Final = int(mujoco.mjtGeom.mjGEOM_SPHERE)
_OVERRIDE_FLAG: Final = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
_LEAST_SOLMIX: Final = 1e-15
"""MuJoCo's mjMINVAL: a geom of a lower ``solmix`` has no part in a mean."""
_LEAST_IMPEDANCE: Final = 1e-4
"""MuJoCo's mjMINIMP."""
_LEAST_FRICTION: Final = 1e-5
"""MuJoCo's mjMINMU."""
_FRICTION_KINDS: Final = (0, 0, 1, 2, 2)
"""A contact's five coefficients of friction as places in a geom's three: sliding, torsional, rolling."""
_Vector = tuple[float, float, float]
_N_TYPES: Final = int(mujoco.mjtGeom.mjNGEOMTYPES)
_TABLE: Final = (ctypes.c_void_p * (_N_TYPES * _N_TYPES)).in_dll(LIBRARY, "mjCOLLISIONFUNC")
_LOCK: Final = "craftsim_lock"
_installing: Final = threading.Lock()

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


def _ctype(declaration: Any) -> Any:
    """Return the type in ctypes of a member of one of MuJoCo's structures."""
    if isinstance(declaration, ast_nodes.AnonymousStructDecl):
        members = [(member.name, _ctype(member.type)) for member in declaration.fields]
        return type("Anonymous", (ctypes.Structure,), {"_fields_": members})
    if isinstance(declaration, ast_nodes.ArrayType):
        kind = _ctype(declaration.inner_type)
        for length in reversed(declaration.extents):
            kind = kind * length
        return kind
    if isinstance(declaration, ast_nodes.PointerType):
        return ctypes.c_void_p
    name = re.sub(r"^(struct )?(\w+?)_?$", r"\2", declaration.name)
    if name in _NUMBERS:
        return _NUMBERS[name]
    if name in structs.STRUCTS:
        return _structure(name)
    # An enumeration.
    return ctypes.c_int


@cache
def _structure(name: str) -> Any:
    members = [(member.name, _ctype(member.type)) for member in structs.STRUCTS[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": members})


_MODEL: Final = _structure("mjModel")
_OPTIONS: Final = _structure("mjOption")
_DATA: Final = _structure("mjData")
_CONTACT: Final = _structure("mjContact")
_PRE_CONTACT: Final = _structure("mjPreContact")


def _place(structure: Any, member: str, size: int) -> int:
    """Return where a member of a structure begins, counted in words of a size."""
    offset: int = getattr(structure, member).offset
    return offset // size


_N_USER_AT: Final = _place(_MODEL, "nuser_geom", 8)
_BODY: Final = _place(_MODEL, "geom_bodyid", 8)
_PARENT: Final = _place(_MODEL, "body_parentid", 8)
_ROOT: Final = _place(_MODEL, "body_rootid", 8)
_N_DOFS: Final = _place(_MODEL, "body_dofnum", 8)
_DOF: Final = _place(_MODEL, "body_dofadr", 8)
_DOF_BEFORE: Final = _place(_MODEL, "dof_parentid", 8)
_USER: Final = _place(_MODEL, "geom_user", 8)
_FRICTION: Final = _place(_MODEL, "geom_friction", 8)
_PRIORITY: Final = _place(_MODEL, "geom_priority", 8)
_SOLMIX: Final = _place(_MODEL, "geom_solmix", 8)
_SOLREF: Final = _place(_MODEL, "geom_solref", 8)
_SOLIMP: Final = _place(_MODEL, "geom_solimp", 8)
_MARGIN: Final = _place(_MODEL, "geom_margin", 8)
_ADHESION: Final = _place(_MODEL, "geom_adhesion", 8)
_N_PAIRS: Final = _place(_MODEL, "npair", 8)
_PAIR_FIRST: Final = _place(_MODEL, "pair_geom1", 8)
_PAIR_SECOND: Final = _place(_MODEL, "pair_geom2", 8)
_ENABLED: Final = _place(_MODEL, "opt", 4) + _place(_OPTIONS, "enableflags", 4)
_OVERRIDE_MARGIN: Final = _place(_MODEL, "opt", 8) + _place(_OPTIONS, "o_margin", 8)
_OVERRIDE_SOLREF: Final = _place(_MODEL, "opt", 8) + _place(_OPTIONS, "o_solref", 8)
_OVERRIDE_SOLIMP: Final = _place(_MODEL, "opt", 8) + _place(_OPTIONS, "o_solimp", 8)
_OVERRIDE_FRICTION: Final = _place(_MODEL, "opt", 8) + _place(_OPTIONS, "o_friction", 8)
_POSITION: Final = _place(_DATA, "geom_xpos", 8)
_AXES: Final = _place(_DATA, "geom_xmat", 8)
_SPEEDS: Final = _place(_DATA, "qvel", 8)
_MOTIONS: Final = _place(_DATA, "cdof", 8)
_CENTRES: Final = _place(_DATA, "subtree_com", 8)
_ARENA: Final = _place(_DATA, "arena", 8)
_ARENA_BYTES: Final = _place(_DATA, "narena", 8)
_CONTACTS: Final = _place(_DATA, "contact", 8)
_N_CONTACTS: Final = _place(_DATA, "ncon", 4)
_IS_THREADED: Final = _place(_DATA, "threadlock", 1)
_PRE_SIZE: Final = ctypes.sizeof(_PRE_CONTACT) // 8
_PRE_DISTANCE: Final = _place(_PRE_CONTACT, "dist", 8)
_PRE_POSITION: Final = _place(_PRE_CONTACT, "pos", 8)
_PRE_NORMAL: Final = _place(_PRE_CONTACT, "normal", 8)
_PRE_TANGENT: Final = _place(_PRE_CONTACT, "tangent", 8)
_CONTACT_SIZE: Final = ctypes.sizeof(_CONTACT) // 8
_CONTACT_DISTANCE: Final = _place(_CONTACT, "dist", 8)
_CONTACT_POSITION: Final = _place(_CONTACT, "pos", 8)
_CONTACT_FRAME: Final = _place(_CONTACT, "frame", 8)
_CONTACT_FRICTION: Final = _place(_CONTACT, "friction", 8)
_CONTACT_SOLREF: Final = _place(_CONTACT, "solref", 8)
_CONTACT_SOLREF_FRICTION: Final = _place(_CONTACT, "solreffriction", 8)
_CONTACT_SOLIMP: Final = _place(_CONTACT, "solimp", 8)
_CONTACT_MARGIN: Final = _place(_CONTACT, "includemargin", 8)
_CONTACT_ADHESION: Final = _place(_CONTACT, "adhesion", 8)
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

else:
    _add_contact = types.ExternalFunction(
        "mj_addContact", types.int32(types.int64, types.int64, types.int64)
    )


@compiled
def _set_parameters(model: int, geom1: int, geom2: int, contact: int) -> None:
    """Write into a contact the parameters that MuJoCo gives to contacts of two geoms.

    This does what mj_contactParam and mj_setContact do in MuJoCo's src/engine/engine_collision_driver.c.
    """
    words = words_at(model)
    flags = integers_at(model)[_ENABLED]
    priority = integers_at(words[_PRIORITY])
    solmix = doubles_at(words[_SOLMIX])
    solref = doubles_at(words[_SOLREF])
    solimp = doubles_at(words[_SOLIMP])
    friction = doubles_at(words[_FRICTION])
    margin = doubles_at(words[_MARGIN])
    adhesion = doubles_at(words[_ADHESION])
    options = doubles_at(model)
    numbers = doubles_at(contact)
    # The geom of the higher priority decides alone.
    first = geom1
    second = geom2
    if priority[geom1] > priority[geom2]:
        second = geom1
    elif priority[geom1] < priority[geom2]:
        first = geom2
    if solmix[first] >= _LEAST_SOLMIX and solmix[second] >= _LEAST_SOLMIX:
        share = solmix[first] / (solmix[first] + solmix[second])
    elif solmix[first] >= _LEAST_SOLMIX:
        share = 1.0
    elif solmix[second] >= _LEAST_SOLMIX:
        share = 0.0
    else:
        share = 0.5
    is_overridden = (flags & _OVERRIDE_FLAG) != 0
    # A stiffness is given as a negative number; it is not mixed.
    is_mixed = solref[2 * first] > 0.0 and solref[2 * second] > 0.0
    # A soft tyre grips as a hard one does: with its own time constant it would creep.
    harder = first
    if solref[2 * second] < solref[2 * first]:
        harder = second
    for number in range(2):
        value1 = solref[2 * first + number]
        value2 = solref[2 * second + number]
        value = min(value1, value2)
        friction_value = 0.0
        if is_mixed:
            value = share * value1 + (1.0 - share) * value2
            friction_value = solref[2 * harder + number]
        if is_overridden:
            value = options[_OVERRIDE_SOLREF + number]
            friction_value = value
        numbers[_CONTACT_SOLREF + number] = value
        numbers[_CONTACT_SOLREF_FRICTION + number] = friction_value
    for number in range(5):
        value = share * solimp[5 * first + number] + (1.0 - share) * solimp[5 * second + number]
        if is_overridden:
            value = options[_OVERRIDE_SOLIMP + number]
        numbers[_CONTACT_SOLIMP + number] = value
    for number in range(5):
        kind = _FRICTION_KINDS[number]
        value = max(friction[3 * first + kind], friction[3 * second + kind])
        if is_overridden:
            value = options[_OVERRIDE_FRICTION + number]
        numbers[_CONTACT_FRICTION + number] = max(value, _LEAST_FRICTION)
    value = margin[geom1] + margin[geom2]
    if is_overridden:
        value = options[_OVERRIDE_MARGIN]
    numbers[_CONTACT_MARGIN] = value
    value = adhesion[first]
    if first != second:
        value += adhesion[second]
    numbers[_CONTACT_ADHESION] = value


@compiled
def _is_pair(model: int, geom1: int, geom2: int) -> bool:
    """Return whether a model has an explicit pair of two geoms."""
    words = words_at(model)
    firsts = integers_at(words[_PAIR_FIRST])
    seconds = integers_at(words[_PAIR_SECOND])
    for pair in range(words[_N_PAIRS]):
        if firsts[pair] == geom1 and seconds[pair] == geom2:
            return True
        if firsts[pair] == geom2 and seconds[pair] == geom1:
            return True
    return False


@compiled
def _order(model: int, contact: int) -> tuple[int, int, int, int]:
    """Return the bodies and geoms of a contact, by which MuJoCo orders contacts."""
    bodies = integers_at(words_at(model)[_BODY])
    integers = integers_at(contact)
    first = min(integers[_CONTACT_GEOM1], integers[_CONTACT_GEOM2])
    second = max(integers[_CONTACT_GEOM1], integers[_CONTACT_GEOM2])
    if first < 0:
        # Of a flex. It stays where it is.
        return (-1, -1, -1, -1)
    return (bodies[first], bodies[second], first, second)


@compiled
def _move_last_into_order(model: int, data: int) -> None:
    """Move the last contact to where it would be if one thread had found all contacts."""
    first = words_at(data)[_CONTACTS]
    contact = first + 8 * _CONTACT_SIZE * (integers_at(data)[_N_CONTACTS] - 1)
    while contact > first:
        previous = contact - 8 * _CONTACT_SIZE
        if _order(model, previous) <= _order(model, contact):
            return
        later = words_at(previous)
        earlier = words_at(contact)
        for word in range(_CONTACT_SIZE):
            value = later[word]
            later[word] = earlier[word]
            earlier[word] = value
        contact = previous


@compiled
def _speed(model: int, data: int, geom: int, point: _Vector, axis: _Vector) -> float:
    """Return the speed along an axis with which a geom's body moves at a point; all in the world's frame."""
    model_words = words_at(model)
    data_words = words_at(data)
    parents = integers_at(model_words[_PARENT])
    n_dofs = integers_at(model_words[_N_DOFS])
    dofs_before = integers_at(model_words[_DOF_BEFORE])
    speeds = doubles_at(data_words[_SPEEDS])
    motions = doubles_at(data_words[_MOTIONS])
    centres = doubles_at(data_words[_CENTRES])
    body = integers_at(model_words[_BODY])[geom]
    while body > 0 and n_dofs[body] == 0:
        body = parents[body]
    if body == 0:
        return 0.0
    root = integers_at(model_words[_ROOT])[body]
    x = point[0] - centres[3 * root]
    y = point[1] - centres[3 * root + 1]
    z = point[2] - centres[3 * root + 2]
    speed = 0.0
    dof = integers_at(model_words[_DOF])[body] + n_dofs[body] - 1
    while dof >= 0:
        # Rotation and translation of the centre by a unit of the joint's speed.
        at = 6 * dof
        v_x = motions[at + 3] + motions[at + 1] * z - motions[at + 2] * y
        v_y = motions[at + 4] + motions[at + 2] * x - motions[at] * z
        v_z = motions[at + 5] + motions[at] * y - motions[at + 1] * x
        speed += speeds[dof] * (v_x * axis[0] + v_y * axis[1] + v_z * axis[2])
        dof = dofs_before[dof]
    return speed


@compiled
def _most_across(model: int, data: int, geom1: int, geom2: int, contact: int) -> float:
    """Return the largest coefficient of friction along the second tangent that hardly lifts a wheel which slides.

    MuJoCo damps friction with b = 2 / (dmax timeconst), or with what is given as a negative number, and at rest a
    contact gives way by g (1 - d0) / d0 over its stiffness.
    """
    numbers = doubles_at(contact)
    place = (
        numbers[_CONTACT_POSITION],
        numbers[_CONTACT_POSITION + 1],
        numbers[_CONTACT_POSITION + 2],
    )
    tangent = (
        numbers[_CONTACT_FRAME + 6],
        numbers[_CONTACT_FRAME + 7],
        numbers[_CONTACT_FRAME + 8],
    )
    speed = abs(
        _speed(model, data, geom1, place, tangent) - _speed(model, data, geom2, place, tangent)
    )
    least = max(numbers[_CONTACT_SOLIMP], _LEAST_IMPEDANCE)
    largest = max(numbers[_CONTACT_SOLIMP + 1], _LEAST_IMPEDANCE)
    reference = _CONTACT_SOLREF_FRICTION
    if numbers[reference] == 0.0:
        reference = _CONTACT_SOLREF
    damping = 2.0 / (largest * max(numbers[reference], _LEAST_SOLMIX))
    if numbers[reference] <= 0.0:
        damping = -numbers[reference + 1] / largest
    lifting = damping * speed
    may_lift = _LIFT * GRAVITY * (1.0 - least) / least
    if lifting <= may_lift:
        return 1.0
    return may_lift / lifting


@compiled(inline=False)
def _take_tyres(
    model: int, data: int, pre_contacts: int, geom1: int, geom2: int, n_contacts: int, contact: int
) -> int:
    """Add the contacts between a tyre and another geom to MuJoCo's; return how many are left to MuJoCo.

    Args:
        model: address of the mjModel.
        data: address of the mjData.
        pre_contacts: address of what MuJoCo's own function has found, of type mjPreContact. Those that are left to
            MuJoCo are moved to the front.
        geom1: the first geom.
        geom2: the second one.
        n_contacts: how many contacts MuJoCo's function has found.
        contact: address of an mjContact of zeros, to be filled in.
    """
    model_words = words_at(model)
    n_user = model_words[_N_USER_AT]
    if n_user < N_USER:
        return n_contacts
    user = doubles_at(model_words[_USER])
    if user[geom1 * n_user] == TYRE:
        tyre = geom1
    elif user[geom2 * n_user] == TYRE:
        tyre = geom2
    else:
        return n_contacts
    data_words = words_at(data)
    arena = data_words[_ARENA]
    if pre_contacts < arena or pre_contacts >= arena + data_words[_ARENA_BYTES]:
        # Asked by mj_geomDistance, for sensors too. What mj_collision asks for lies in MuJoCo's arena.
        return n_contacts
    side = user[tyre * n_user + SIDE]
    across = user[tyre * n_user + ACROSS]
    half_width = user[tyre * n_user + HALF_WIDTH]
    positions = doubles_at(data_words[_POSITION])
    axes = doubles_at(data_words[_AXES])
    axle = (axes[9 * tyre + 1], axes[9 * tyre + 4], axes[9 * tyre + 7])
    numbers = doubles_at(contact)
    integers = integers_at(contact)
    pre_numbers = doubles_at(pre_contacts)
    is_pair = _is_pair(model, geom1, geom2)
    if not is_pair:
        _set_parameters(model, geom1, geom2, contact)
        along = numbers[_CONTACT_FRICTION]
    n_left = 0
    for number in range(n_contacts):
        at = number * _PRE_SIZE
        place = at + _PRE_POSITION
        normal = at + _PRE_NORMAL
        # From the wheel's centre to the contact.
        r_x = pre_numbers[place] - positions[3 * tyre]
        r_y = pre_numbers[place + 1] - positions[3 * tyre + 1]
        r_z = pre_numbers[place + 2] - positions[3 * tyre + 2]
        if abs(r_x * axle[0] + r_y * axle[1] + r_z * axle[2]) > half_width:
            # The sphere is wider than the wheel, whose flanks are another geom.
            continue
        # Along the tread, t = r x y.
        t_x = r_y * axle[2] - r_z * axle[1]
        t_y = r_z * axle[0] - r_x * axle[2]
        t_z = r_x * axle[1] - r_y * axle[0]
        length = (t_x * t_x + t_y * t_y + t_z * t_z) ** 0.5
        # None where what touches is at the wheel's centre or on its axle.
        has_axis = length > 0.0
        if has_axis:
            # The roller's axis, in the plane of the contact.
            a_x = t_x / length + side * axle[0]
            a_y = t_y / length + side * axle[1]
            a_z = t_z / length + side * axle[2]
            n_x = pre_numbers[normal]
            n_y = pre_numbers[normal + 1]
            n_z = pre_numbers[normal + 2]
            out = a_x * n_x + a_y * n_y + a_z * n_z
            a_x -= out * n_x
            a_y -= out * n_y
            a_z -= out * n_z
            length = (a_x * a_x + a_y * a_y + a_z * a_z) ** 0.5
            a_x /= length
            a_y /= length
            a_z /= length
            pre_numbers[at + _PRE_TANGENT] = a_x
            pre_numbers[at + _PRE_TANGENT + 1] = a_y
            pre_numbers[at + _PRE_TANGENT + 2] = a_z
        if is_pair or not has_axis:
            for word in range(_PRE_SIZE):
                pre_numbers[n_left * _PRE_SIZE + word] = pre_numbers[at + word]
            n_left += 1
            continue
        gap = pre_numbers[at + _PRE_DISTANCE]
        numbers[_CONTACT_DISTANCE] = gap
        for axis in range(3):
            numbers[_CONTACT_POSITION + axis] = pre_numbers[place + axis]
            numbers[_CONTACT_FRAME + axis] = pre_numbers[normal + axis]
        numbers[_CONTACT_FRAME + 3] = a_x
        numbers[_CONTACT_FRAME + 4] = a_y
        numbers[_CONTACT_FRAME + 5] = a_z
        numbers[_CONTACT_FRAME + 6] = n_y * a_z - n_z * a_y
        numbers[_CONTACT_FRAME + 7] = n_z * a_x - n_x * a_z
        numbers[_CONTACT_FRAME + 8] = n_x * a_y - n_y * a_x
        friction_across = min(across, along, _most_across(model, data, geom1, geom2, contact))
        numbers[_CONTACT_FRICTION + 1] = max(friction_across, _LEAST_FRICTION)
        integers[_CONTACT_GEOM1] = geom1
        integers[_CONTACT_GEOM2] = geom2
        integers[_CONTACT_GEOMS] = geom1
        integers[_CONTACT_GEOMS + 1] = geom2
        for end in range(2):
            integers[_CONTACT_FLEX + end] = -1
            integers[_CONTACT_ELEMENT + end] = -1
            integers[_CONTACT_VERTEX + end] = -1
        integers[_CONTACT_ROWS] = -1
        # Adhesion pulls without friction where geoms are near each other and do not touch.
        is_apart = gap >= numbers[_CONTACT_MARGIN]
        is_adhesive = numbers[_CONTACT_ADHESION] != 0.0
        integers[_CONTACT_EXCLUDE] = is_apart and not is_adhesive
        integers[_CONTACT_DIM] = 1 if is_apart and is_adhesive else 3
        # Where there is no memory, MuJoCo counts a warning, and the contact is missing, as any other is then.
        is_full = _add_contact(model, data, contact)
        if not is_full and bytes_at(data)[_IS_THREADED]:
            _move_last_into_order(model, data)
    return n_left


def _add_entry(module: ir.Module, name: str, original: int, take_tyres: int) -> None:
    """Add a collision function, which calls MuJoCo's own and then takes the contacts of tyres from what that found.

    Where a pool of MuJoCo's threads looks for the contacts of one mjData, these are added by one thread at a time.
    """
    byte = ir.IntType(8)
    word = ir.IntType(64)
    number = ir.IntType(32)
    arguments = [word, word, word, number, number, ir.DoubleType()]
    kind = ir.FunctionType(number, arguments)
    function = ir.Function(module, kind, name)
    builder = ir.IRBuilder(function.append_basic_block())
    model, data, pre_contacts, geom1, geom2, margin = function.args
    collide = builder.inttoptr(word(original), kind.as_pointer())
    n_contacts = builder.call(collide, [model, data, pre_contacts, geom1, geom2, margin])
    with builder.if_then(builder.icmp_signed("<", n_contacts, number(1))):
        builder.ret(n_contacts)
    contact = builder.alloca(ir.ArrayType(word, _CONTACT_SIZE))
    builder.store(ir.Constant(contact.type.pointee, None), contact)
    lock = module.globals[_LOCK]
    place = builder.inttoptr(builder.add(data, word(_IS_THREADED)), byte.as_pointer())
    is_threaded = builder.icmp_unsigned("!=", builder.load(place), byte(0))
    with builder.if_then(is_threaded):
        attempt = builder.append_basic_block()
        success = builder.append_basic_block()
        builder.branch(attempt)
        builder.position_at_end(attempt)
        exchange = builder.cmpxchg(lock, number(0), number(1), "acquire", "monotonic")
        builder.cbranch(builder.extract_value(exchange, 1), success, attempt)
        builder.position_at_end(success)
    take_type = ir.FunctionType(word, [word] * 7)
    take_pointer = builder.inttoptr(word(take_tyres), take_type.as_pointer())
    n_left = builder.call(
        take_pointer,
        [
            model,
            data,
            pre_contacts,
            builder.sext(geom1, word),
            builder.sext(geom2, word),
            builder.sext(n_contacts, word),
            builder.ptrtoint(contact, word),
        ],
    )
    with builder.if_then(is_threaded):
        builder.store_atomic(number(0), lock, "release", 4)
    builder.ret(builder.trunc(n_left, number))


def _collision_functions() -> dict[int, int]:
    """Return MuJoCo's functions of pairs of shapes of which a tyre can be one, by their places in the table."""
    functions = {}
    for other in range(_N_TYPES):
        for place in (_SPHERE * _N_TYPES + other, other * _N_TYPES + _SPHERE):
            address = _TABLE[place]
            if address:
                functions[place] = address
    return functions


def install() -> None:
    """Let MuJoCo, in this process, find contacts of tyres as this module says."""
    with _installing:
        _install()


@cache
def _install() -> None:
    _check_layout()
    take_tyres = address_of(_take_tyres, (types.int64,) * 7)
    module = ir.Module()
    lock = ir.GlobalVariable(module, ir.IntType(32), _LOCK)
    lock.linkage = "internal"
    lock.initializer = ir.IntType(32)(0)
    originals = _collision_functions()
    for place, original in originals.items():
        _add_entry(module, f"craftsim_collide_{place}", original, take_tyres)
    engine = machine_code(module)
    for place in originals:
        _TABLE[place] = engine.get_function_address(f"craftsim_collide_{place}")


def tyres_of(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the geoms of a model that are tyres."""
    if model.nuser_geom < N_USER:
        return np.zeros(0, np.intp)
    return np.flatnonzero(model.geom_user[:, 0] == TYRE)


def _check_layout() -> None:
    """Raise ImportError where MuJoCo's structures are not as it describes them."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="lower", size=[1.0, 0.0, 0.0], userdata=[0.0] * N_USER)
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 1.5])
    body.add_freejoint()
    body.add_geom(name="upper", size=[1.0, 0.0, 0.0])
    spec.add_pair(geomname1="lower", geomname2="upper")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model_memory = _MODEL.from_address(model._address)
    data_memory = _DATA.from_address(data._address)
    contact_memory = _CONTACT.from_address(data_memory.contact)
    contact = data.contact[0]
    agree = (
        model_memory.nuser_geom == model.nuser_geom,
        model_memory.geom_user == model.geom_user.ctypes.data,
        model_memory.geom_friction == model.geom_friction.ctypes.data,
        model_memory.geom_priority == model.geom_priority.ctypes.data,
        model_memory.geom_solmix == model.geom_solmix.ctypes.data,
        model_memory.geom_solref == model.geom_solref.ctypes.data,
        model_memory.geom_solimp == model.geom_solimp.ctypes.data,
        model_memory.geom_margin == model.geom_margin.ctypes.data,
        model_memory.geom_adhesion == model.geom_adhesion.ctypes.data,
        model_memory.geom_bodyid == model.geom_bodyid.ctypes.data,
        model_memory.body_parentid == model.body_parentid.ctypes.data,
        model_memory.body_rootid == model.body_rootid.ctypes.data,
        model_memory.body_dofnum == model.body_dofnum.ctypes.data,
        model_memory.body_dofadr == model.body_dofadr.ctypes.data,
        model_memory.dof_parentid == model.dof_parentid.ctypes.data,
        model_memory.npair == model.npair,
        model_memory.pair_geom1 == model.pair_geom1.ctypes.data,
        model_memory.pair_geom2 == model.pair_geom2.ctypes.data,
        model_memory.opt.enableflags == model.opt.enableflags,
        model_memory.opt.o_margin == model.opt.o_margin,
        list(model_memory.opt.o_solref) == model.opt.o_solref.tolist(),
        list(model_memory.opt.o_solimp) == model.opt.o_solimp.tolist(),
        list(model_memory.opt.o_friction) == model.opt.o_friction.tolist(),
        data_memory.narena == data.narena,
        data_memory.arena == data_memory.contact,
        data_memory.ncon == data.ncon,
        data_memory.qvel == data.qvel.ctypes.data,
        data_memory.cdof == data.cdof.ctypes.data,
        data_memory.subtree_com == data.subtree_com.ctypes.data,
        data_memory.geom_xpos == data.geom_xpos.ctypes.data,
        data_memory.geom_xmat == data.geom_xmat.ctypes.data,
        contact_memory.dist == contact.dist,
        list(contact_memory.pos) == contact.pos.tolist(),
        list(contact_memory.frame) == contact.frame.tolist(),
        list(contact_memory.friction) == contact.friction.tolist(),
        list(contact_memory.solref) == contact.solref.tolist(),
        list(contact_memory.solreffriction) == contact.solreffriction.tolist(),
        list(contact_memory.solimp) == contact.solimp.tolist(),
        contact_memory.includemargin == contact.includemargin,
        contact_memory.adhesion == contact.adhesion,
        contact_memory.dim == contact.dim,
        contact_memory.geom1 == contact.geom1,
        contact_memory.geom2 == contact.geom2,
        list(contact_memory.geom) == contact.geom.tolist(),
        list(contact_memory.flex) == contact.flex.tolist(),
        list(contact_memory.elem) == contact.elem.tolist(),
        list(contact_memory.vert) == contact.vert.tolist(),
        contact_memory.exclude == contact.exclude,
        contact_memory.efc_address == contact.efc_address,
    )
    if not all(agree):
        raise ImportError(
            f"MuJoCo {mujoco.__version__} lays its structures out otherwise than mujoco.introspect says, which "
            "craftsim needs for the contacts of wheels; install another release: python -m pip install 'mujoco<4'"
        )

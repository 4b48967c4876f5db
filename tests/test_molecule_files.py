"""Files of molecules: read by ase what ase wrote, in each format; written frames that ase reads back."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import molecules

ase = pytest.importorskip("ase")
from ase import io, units  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning")  # in ase

MASSES, PLACES = np.array([15.999, 1.008, 1.008]), np.array([[0, 0, 0], [0.0816, 0.0577, 0], [-0.0816, 0.0577, 0]])
BOX = 1.6


def box_of_water(count=8):
    rng = np.random.default_rng(0)
    body, points = ml.molecules.from_points(MASSES, PLACES)
    attitude = Rotation.random(count, rng).as_quat(scalar_first=True)
    place = np.stack(np.meshgrid(*[[0.05, 0.85]] * 3), -1).reshape(-1, 3)[:count]
    momentum, linear = 0.05 * rng.normal(size=(2, count, 3))
    return body, points, ml.CoupledState(momentum, attitude, 100 * linear, place)


def as_atoms(body: Any, points, state, symbols="OHH") -> Any:
    places, spin = np.asarray(ml.molecules.sites(state, points)), state.momentum
    if symbols == "OHH":
        spin = np.asarray(ml.so3.rotate(state.attitude, spin / body.body.moments[None]))
    else:
        spin = np.asarray(spin) / float(body.body.moment)
    arms = places - np.asarray(state.position)[:, None]
    velocities = np.asarray(state.linear)[:, None] / float(body.mass) + np.cross(spin[:, None], arms)
    atoms = ase.Atoms(symbols * len(places), 10 * places.reshape(-1, 3), cell=[10 * BOX] * 3, pbc=True)
    atoms.set_velocities(velocities.reshape(-1, 3) * 10 / (1000 * units.fs))
    atoms.wrap()
    return atoms


LAMMPS: Any = {"format": "lammps-data", "units": "real", "atom_style": "full"}


@pytest.mark.parametrize(("name", "digits"), [("w.xyz", 1e-6), ("w.gro", 1.1e-3), ("w.pdb", 1e-4), ("w.data", 1e-6)])
def test_a_start_comes_from_a_file(name, digits, tmp_path):
    body, points, start = box_of_water()
    written = {"w.xyz": {"format": "extxyz"}, "w.data": {**LAMMPS, "velocities": True, "masses": True}}.get(name, {})
    io.write(tmp_path / name, as_atoms(body, points, start), **written)
    found = molecules.read(tmp_path / name, 3, masses=MASSES, **(LAMMPS if name == "w.data" else {}))
    moments = [np.asarray(one.inertia().rotation.moments) for one in (found.body, body)]
    np.testing.assert_allclose(*moments, rtol=40 * digits)
    np.testing.assert_allclose(found.box, [BOX] * 3, atol=1e-4)
    # At the images that the file has: the same atoms, up to whole boxes.
    way = np.subtract(*(ml.molecules.sites(*at) for at in ((found.start, found.points), (start, points)))) / BOX
    assert np.abs(way - np.round(way)).max() * BOX < 2 * digits
    if name.endswith(("xyz", "data")):
        np.testing.assert_allclose(found.start.linear, start.linear, atol=1e-3)
        both: Any = found.start, start
        spin = [np.asarray(ml.so3.rotate(s.attitude, s.momentum)) for s in both]
        np.testing.assert_allclose(*spin, atol=1e-4)


def test_types_of_lammps_are_not_taken_for_elements(tmp_path):
    """As ase writes them by default, without a section Masses: the types H = 1 and O = 2 would be H and He."""
    atoms, file = as_atoms(*box_of_water(2)), tmp_path / "w.data"
    io.write(file, atoms, **LAMMPS)
    with pytest.raises(ValueError, match=r"section Masses.*\(HeH2\)\. Pass masses, or Z_of_type"):
        molecules.read(file, 3, **LAMMPS)
    for more in ({"masses": MASSES}, {"Z_of_type": {1: 1, 2: 8}}):
        found = molecules.read(file, 3, **more, **LAMMPS)
        assert found.symbols == ["O", "H", "H"]
        np.testing.assert_allclose(found.body.mass, MASSES.sum(), rtol=1e-12)


def test_linear_molecules_have_an_axis(tmp_path):
    masses, rng = np.array([15.999, 12.011, 15.999]), np.random.default_rng(1)
    body, points = ml.molecules.from_points(masses, [[0, 0, -0.116], [0, 0, 0], [0, 0, 0.116]])
    axis = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
    momentum, linear = np.cross(axis, rng.normal(size=(2, 3))), rng.normal(size=(2, 3))
    start = ml.CoupledFreeAxisState(momentum, axis, linear, position=[[0.3, 0.2, 0.1], [0.7, 0.2, 0.9]])
    io.write(tmp_path / "c.xyz", as_atoms(body, points, start, "OCO"))
    found = molecules.read(tmp_path / "c.xyz", 3)
    assert isinstance(found.start, ml.CoupledFreeAxisState)
    for name in ("momentum", "axis", "linear", "position"):
        np.testing.assert_allclose(getattr(found.start, name), getattr(start, name), atol=1e-5)


def test_a_trajectory_is_read_by_others(tmp_path):
    body, points, start = box_of_water(4)
    path = ml.integrate("JACOBI[EA]", body, None, start, dt=0.001, steps=20, save_every=10)
    molecules.write_xyz(tmp_path / "sites.xyz", path, points=points, symbols=["O", "H", "H"], box=BOX)
    frames: Any = io.read(tmp_path / "sites.xyz", index=":")
    assert len(frames) == 3
    assert frames[0].get_chemical_symbols() == ["O", "H", "H"] * 4
    places = np.asarray(jax.vmap(lambda s: ml.molecules.sites(s, points))(path.states))
    np.testing.assert_allclose(frames[2].get_positions(), 10 * places[2].reshape(-1, 3), atol=1e-7)
    np.testing.assert_allclose(np.diag(frames[1].get_cell()), [10 * BOX] * 3)
    np.testing.assert_array_equal(frames[1].arrays["molecule"], np.repeat([1, 2, 3, 4], 3))
    molecules.write_xyz(tmp_path / "bodies.xyz", path)
    bodies: Any = io.read(tmp_path / "bodies.xyz", index=1)
    quaternions = np.asarray(path.states.attitude[1])[:, [1, 2, 3, 0]]
    np.testing.assert_allclose(bodies.arrays["orientation"], quaternions, atol=1e-8)


def test_what_cannot_be_read_or_written(tmp_path):
    body, points, start = box_of_water(2)
    atoms = as_atoms(body, points, start)
    moved, other = atoms.copy(), atoms.copy()
    moved.positions[4] += 0.5
    other.set_chemical_symbols(["O", "H", "H", "H", "O", "H"])
    for written, count, message in (
        (atoms, 4, "must have a multiple"),
        (moved, 3, "differ in shape"),
        (other, 3, "must be equal"),
    ):
        io.write(tmp_path / "w.xyz", written)
        with pytest.raises(ValueError, match=message):
            molecules.read(tmp_path / "w.xyz", count)
    path = ml.integrate("JACOBI[EA]", body, None, start.of_body(0), dt=0.001, steps=1)
    with pytest.raises(ValueError, match="one run of a CoupledState"):
        molecules.write_xyz(tmp_path / "x.xyz", path)
    path = path._replace(states=jax.tree.map(lambda x: jnp.stack([x, x], axis=1), path.states))
    path = path._replace(states=ml.CoupledState.of_bodies(path.states))
    with pytest.raises(ValueError, match="one for each of 3 points"):
        molecules.write_xyz(tmp_path / "x.xyz", path, points=points, symbols=["O", "H"])

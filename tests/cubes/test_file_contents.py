"""Contents of a file beside its cube are used or refused, whatever the format: the grid above all."""

from __future__ import annotations

import struct
import zipfile
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr
from scipy.io import savemat
from scipy.sparse import csc_array, csc_matrix

from isacbench import get_estimator, load_scenario, observe_cube
from isacbench.cubes import open_cube, read_grid
from isacbench.errors import InputError, InputWarning
from isacbench.model.echo import resource_grid

from .samples import SHAPE, assert_gives, put_mat73, random_cube, write_mat73, write_zarr

N, M = SHAPE[:2]
QPSK = np.exp(0.5j * np.pi * np.random.default_rng(1).integers(4, size=(N, M)))
CUBE = random_cube(dtype=np.complex128) * QPSK[:, :, None, None]
CELL = np.empty((1, 1), object)
CELL[0, 0] = QPSK
RECORDS = QPSK.view([("re", "f8"), ("im", "f8")])

MINI = """name = "mini"
[system]
n_subcarriers = 128
n_symbols = 56
[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [8, 8]
[base_station]
position_m = [0, 60, 10]
[region]
x_m = [-60, 60]
y_m = [0, 60]
z_m = [0, 20]
speed_mps = [-40, 40]
[[objects]]
kind = "point"
position_m = [3, 10, 5]
velocity_mps = 7.3
"""


def npz(**arrays):
    return ".npz", partial(np.savez, **arrays)


def mat(**arrays):
    return ".mat", lambda path: savemat(path, arrays)


def mat73(**arrays):
    def write(path):
        write_mat73(path)
        with h5py.File(path, "a") as file:
            for name, array in arrays.items():
                put_mat73(file, name, np.asarray(array))

    return ".mat", write


def h5(change=None, **arrays):
    def write(path):
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
            if change is not None:
                change(file)

    return ".h5", write


def zarr_of(**arrays):
    return ".zarr", lambda path: write_zarr(path, **arrays)


def members(**contents):
    """An npz file with members of other kinds than arrays."""

    def write(path):
        np.savez(path, cube=CUBE)
        with zipfile.ZipFile(path, "a") as archive:
            for name, data in contents.items():
                archive.writestr(name, data)

    return ".npz", write


def added_to_consolidated(path):
    write_zarr(path, zarr_format=2, cube=CUBE)
    zarr.consolidate_metadata(path)
    zarr.open_group(path, mode="a", use_consolidated=False).create_array("transmitted", data=QPSK)


def of_two_versions(path):
    write_zarr(path, cube=CUBE)
    zarr.create_array(path / "transmitted", data=QPSK, zarr_format=2)


def with_zarr_attribute(path):
    write_zarr(path, cube=CUBE)
    zarr.open(path)["cube"].attrs["transmitted"] = "QPSK of seed 1"


def with_zarr_grid(path):
    write_zarr(path, cube=CUBE)
    zarr.open(path).attrs["grid"] = QPSK.real.tolist()


def with_rows(name):
    def change(file):
        rows = file.create_dataset(name, (N,), h5py.vlen_dtype(np.float64))
        for n in range(N):
            rows[n] = QPSK[n].view(float)

    return change


def with_references(file):
    """An array of structures, as MATLAB writes it in version 7.3."""
    put_mat73(file, "#refs#/a", QPSK)
    file.create_dataset("frame/tx", (2, 1), h5py.ref_dtype)[...] = file["#refs#/a"].ref
    file["frame"].attrs["MATLAB_class"] = np.bytes_("struct")


def group_twice(file):
    file["symbols/values"] = np.ones(3)
    file["transmitted"] = file["symbols"]


def sparse73(path):
    mat73(cube=CUBE)[1](path)
    with h5py.File(path, "a") as file:
        put_mat73(file, "transmitted/data", QPSK.ravel())
        file["transmitted"].attrs["MATLAB_class"] = np.bytes_("double")
        file["transmitted"].attrs["MATLAB_sparse"] = np.uint64(N)


def of_class(name, kind):
    def change(file):
        put_mat73(file, name, np.ones((1, 6), np.uint32))
        file[name].attrs["MATLAB_class"] = np.bytes_(kind)

    return change


def mat_objects(*names):
    """Objects, such as tables and texts in double quotes, after a cube."""

    def text(word):
        return struct.pack("<II", 1, len(word)) + word.encode() + bytes(-len(word) % 8)

    def element(*parts):
        inside = b"".join(parts)
        return struct.pack("<II", 14, len(inside)) + inside

    def write(path):
        savemat(path, {"cube": CUBE})
        plain = path.read_bytes()
        savemat(path, {"a": np.ones((6, 1), np.uint32)})
        metadata = path.read_bytes()[128:]
        head = struct.pack("<IIII", 6, 8, 17, 0)
        objects = [element(head, text(name), text("MCOS"), text("string"), metadata) for name in names]
        path.write_bytes(plain + b"".join(objects))

    return ".mat", write


@pytest.fixture
def path_of(tmp_path):
    def write(suffix_and_writer, name="frame"):
        suffix, writer = suffix_and_writer
        path = Path(tmp_path / f"{name}{suffix}")
        writer(path)
        return path

    return write


USED = {
    "capital": npz(cube=CUBE, Transmitted=QPSK),
    "spaces": npz(**{"Cube": CUBE, " Transmitted ": QPSK}),
    "capital, mat": mat(Cube=CUBE, TRANSMITTED=QPSK),
    "structure": mat(cube=CUBE, transmitted={"grid": QPSK}),
    "structure of both": mat(frame={"cube": CUBE, "transmitted": QPSK, "carrier_hz": 70e9}),
    "structure of both, 7.3": mat73(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "flattened": npz(**{"frame.cube": CUBE, "frame.transmitted": QPSK}),
    "groups": h5(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "group of the grid": h5(cube=CUBE, **{"transmitted/values": QPSK}),
    "second link": h5(lambda file: file.update(transmitted=file["symbols"]), cube=CUBE, symbols=QPSK),
    "first link": h5(lambda file: file.update(x=file["transmitted"]), cube=CUBE, transmitted=QPSK),
    "second link of the cube": h5(lambda file: file.update(a=file["cube"]), cube=CUBE, transmitted=QPSK),
    "zarr groups": zarr_of(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "zarr capital": zarr_of(cube=CUBE, Transmitted=QPSK),
    "zarr, consolidated before": (".zarr", added_to_consolidated),
}


@pytest.mark.parametrize("contents", USED.values(), ids=USED)
def test_the_grid_is_used_wherever_it_lies(path_of, contents):
    path = path_of(contents)
    with open_cube(path) as cube:
        assert_gives(cube, CUBE)
        assert np.array_equal(cube.transmitted, QPSK)
    assert np.array_equal(read_grid(path), QPSK)


REFUSED = {
    "sparse": (mat(cube=CUBE, transmitted=csc_matrix(QPSK)), r"transmitted \(sparse matrix\)"),
    "sparse, 7.3": ((".mat", sparse73), r"transmitted \(sparse matrix\)"),
    "cell": (mat(cube=CUBE, transmitted=CELL), r"transmitted \(cell\)"),
    "text": (mat(cube=CUBE, transmitted="grid.mat"), r"transmitted \(char\)"),
    "array of structures": (
        mat(cube=CUBE, transmitted=np.zeros((2, 1), [("grid", object)])),
        r"transmitted \(struct\)",
    ),
    "object": (mat_objects("transmitted"), r"transmitted \(object\)"),
    "object before others": (mat_objects("transmitted", "unit", "units"), r"transmitted \(object\)"),
    "table": (h5(of_class("transmitted", "table"), cube=CUBE), r"transmitted \(table\)"),
    "cell, 7.3": (h5(of_class("transmitted", "cell"), cube=CUBE), r"transmitted \(cell\)"),
    "two fields": (mat(cube=CUBE, transmitted={"re": QPSK.real, "im": QPSK.imag}), "transmitted/re .*/im"),
    "Python objects": (npz(cube=CUBE, transmitted=QPSK.astype(object)), "transmitted .*never unpickled"),
    "no array": (members(**{"transmitted.csv": "1,1"}), r"transmitted.csv \(no array\)"),
    "array under another suffix": (members(transmitted=b"\x93NUMPY"), r"transmitted \(no array\)"),
    "two": (npz(cube=CUBE, transmitted=QPSK, Transmitted=QPSK), "transmitted .*, Transmitted"),
    "two groups": (h5(cube=CUBE, **{"a/transmitted": QPSK, "b/transmitted": QPSK}), "a/transmitted .*, b/"),
    "soft link": (h5(lambda file: file.update(transmitted=h5py.SoftLink("/gone")), cube=CUBE), r"\(link\)"),
    "external link": (
        h5(lambda file: file.update(transmitted=h5py.ExternalLink("grid.h5", "/x")), cube=CUBE),
        r"transmitted \(link\)",
    ),
    "nothing": (h5(cube=CUBE, transmitted=h5py.Empty("c16")), r"transmitted \(dataset\)"),
    "empty group": (h5(lambda file: file.create_group("transmitted"), cube=CUBE), r"transmitted \(group\)"),
    "second name of a group": (h5(group_twice, cube=CUBE), r"transmitted \(group\)"),
    "attribute": (h5(lambda file: file["cube"].attrs.update(Transmitted=1), cube=CUBE), r"\(attribute\)"),
    "attribute of the file": (h5(lambda file: file.attrs.update(transmitted=1), cube=CUBE), r"\(attribute\)"),
    "zarr attribute": ((".zarr", with_zarr_attribute), r"cube@transmitted \(attribute\)"),
    "zarr of another version": ((".zarr", of_two_versions), r"transmitted \(no zarr array\)"),
}


@pytest.mark.parametrize(("contents", "found"), REFUSED.values(), ids=REFUSED)
def test_what_has_the_name_of_the_grid_and_is_no_single_array_is_refused(path_of, contents, found):
    path = path_of(contents)
    for opening in (open_cube, read_grid):
        with pytest.raises(InputError, match=f"needs an array named 'transmitted'; .*{found}"):
            opening(path)


@pytest.mark.parametrize(
    "grid",
    [1.0, QPSK.ravel(), QPSK[:, :-1], QPSK[:, :, None], QPSK.T, np.empty((0, M)), RECORDS, QPSK.astype(str)],
)
def test_a_grid_of_another_shape_or_type_is_refused(path_of, grid):
    path = path_of(npz(cube=CUBE, transmitted=grid))
    with pytest.raises(InputError, match=r"transmitted( has shape|: has shape|: holds)"):
        open_cube(path)


UNCLEAR = {
    "alias": npz(cube=CUBE, tx=QPSK),
    "alias, mat": mat(cube=CUBE, X=QPSK),
    "alias, sparse": mat(cube=CUBE, X=csc_array(QPSK)),
    "alias, structure": mat(cube=CUBE, setup={"tx": QPSK}),
    "alias, group": h5(cube=CUBE, **{"tx/grid": QPSK}),
    "alias, zarr": zarr_of(cube=CUBE, grid=QPSK),
    "alias, cell": mat(cube=CUBE, transmitted_symbols=CELL),
    "alias, objects": npz(cube=CUBE, transmitted_symbols=QPSK.astype(object)),
    "of several antennas": npz(cube=CUBE, symbols=np.stack([QPSK, QPSK], axis=-1)),
    "transposed": npz(cube=CUBE, symbols=QPSK.T),
    "flat": npz(cube=CUBE, symbols=QPSK.ravel()),
    "records": npz(cube=CUBE, symbols=RECORDS),
    "parts": npz(cube=CUBE, re=QPSK.real, im=QPSK.imag),
    "mask": npz(cube=CUBE, used=np.ones((N, M), bool)),
    "imaginary part beside": npz(cube=CUBE, transmitted=QPSK.real, transmitted_im=QPSK.imag),
    "real, flat": npz(cube=CUBE, bpsk=np.ones(N * M)),
    "one number a subcarrier": npz(cube=CUBE, transmitted_preamble=np.sign(QPSK[:, 0].real)),
    "attribute of a name": h5(lambda file: file.attrs.update(transmitted_preamble=QPSK[:, 0]), cube=CUBE),
    "name of a cell in another program": h5(cube=CUBE, **{"#1": QPSK}),
    "attribute": h5(lambda file: file["cube"].attrs.update(grid=QPSK), cube=CUBE),
    "attribute, zarr": (".zarr", with_zarr_grid),
    "grid beside the only cube": npz(echo=CUBE, t=QPSK),
}


@pytest.mark.parametrize("contents", UNCLEAR.values(), ids=UNCLEAR)
def test_other_arrays_with_axes_of_the_frame_are_refused(path_of, contents):
    with pytest.raises(
        InputError,
        match=r"beside the cube, which may be the transmitted grid; allowed is one array named 'tr",
    ):
        open_cube(path_of(contents))


TWO_CUBES = {
    "letters": npz(cube=CUBE, Cube=CUBE),
    "groups": h5(**{"first/cube": CUBE, "second/cube": CUBE}),
    "structure": mat(cube=CELL, echo=CUBE),
    "link": h5(lambda file: file.update(cube=h5py.SoftLink("/echo")), echo=CUBE),
    "parts": npz(cube_re=CUBE.real, cube_im=CUBE.imag),
    "parts in a group": h5(**{"cube/re": CUBE.real, "cube/im": CUBE.imag}),
    "calibration at the root": h5(calibration=np.ones_like(CUBE), **{"rx/data": CUBE}),
}


@pytest.mark.parametrize("contents", TWO_CUBES.values(), ids=TWO_CUBES)
def test_of_what_may_be_the_cube_none_is_guessed(path_of, contents):
    with pytest.raises(InputError, match="needs an array named 'cube'"):
        open_cube(path_of(contents))


@pytest.mark.parametrize("contents", [npz, mat])
def test_a_real_cube_is_refused_with_its_imaginary_part_beside_it(path_of, contents):
    with pytest.raises(InputError, match="cube: holds float64; a cube takes complex64"):
        open_cube(path_of(contents(cube=CUBE.real, cube_im=CUBE.imag)))


OTHERS = {
    "second cube": (npz(cube=CUBE, raw=CUBE), r"raw \(complex128 of shape"),
    "flat cube": (npz(cube=CUBE, raw=CUBE.ravel()), r"raw \(complex128 of shape"),
    "second cube in a group": (h5(cube=CUBE, **{"old/raw": CUBE}), "old/raw"),
    "map beside the grid": (mat(cube=CUBE, transmitted=np.ones((N, M)), map=np.ones((N, M))), "map"),
    "calibration": (h5(cube=CUBE, calibration=np.ones(SHAPE[2:], complex)), r"calibration \(complex"),
    "a vector each symbol": (npz(cube=CUBE, x0=QPSK[:, 0], x1=QPSK[:, 1]), "x0 .*, x1"),
    "signs": (npz(cube=CUBE, preamble=np.tile([1.0, -1.0], N // 2)), "preamble"),
    "real and imaginary parts": (npz(cube=CUBE, x=np.ones((M, 2))), r"x \(float64"),
    "attribute": (h5(lambda file: file.attrs.update(preamble=QPSK[:, 0]), cube=CUBE), "@?preamble"),
    "cell": (mat(cube=CUBE, symbols=CELL), r"symbols \(cell\)$"),
    "Python objects": (npz(cube=CUBE, meta=np.array({"transmitted": QPSK})), "meta .*never unpickled"),
    "records": (
        npz(cube=CUBE, frame=np.zeros(1, [("setup", [("transmitted", "c16", (N, M))])])),
        r"frame \(\[\('setup'",
    ),
    "array of structures": (
        mat(cube=CUBE, frame=np.zeros((2, 1), [("transmitted", object)])),
        r"frame \(struct",
    ),
    "rows of any length": (h5(with_rows("tx"), cube=CUBE), r"tx \(object of shape \(24,\)\)$"),
    "references": (h5(with_references, cube=CUBE), r"frame/tx \(object of shape"),
    "link": (h5(lambda file: file.update(grid=h5py.SoftLink("/x")), cube=CUBE), r"grid \(link\)"),
}


@pytest.mark.parametrize(("contents", "unused"), OTHERS.values(), ids=OTHERS)
def test_what_may_be_data_and_is_not_used_is_told(path_of, contents, unused):
    with (
        pytest.warns(InputWarning, match=f"frame.* does not use {unused}"),
        open_cube(path_of(contents)) as cube,
    ):
        assert_gives(cube, CUBE)


METADATA = {
    "carrier_hz": 70e9,
    "f": np.arange(float(N)),
    "t": np.arange(float(M)),
    "positions": np.ones((12, 3)),
    "element_gain_db": np.ones(SHAPE[2:]),
    "scale": 1 + 0j,
    "note": "by hand",
    "transmitted_power_dbm": 20.0,
    "transmitted_modulation": "QPSK",
}


@pytest.mark.parametrize("contents", [npz, mat, mat73, zarr_of, h5])
def test_scalars_texts_axes_and_other_shapes_beside_the_cube_are_no_grid(path_of, contents):
    held = {name: np.asarray(value) for name, value in METADATA.items()}
    if contents in (zarr_of, h5):
        held = {name: value for name, value in held.items() if value.dtype.kind != "U"}
    with open_cube(path_of(contents(cube=CUBE, **held))) as cube:
        assert_gives(cube, CUBE)
        assert cube.transmitted is None


def test_texts_of_matlab_in_double_quotes_and_structures_of_settings_are_no_grid(path_of):
    with pytest.warns(InputWarning, match=r"does not use unit \(object\), units \(object\)$"):
        cube = open_cube(path_of(mat_objects("unit", "units")))
    assert cube.transmitted is None
    with open_cube(path_of(mat(cube=CUBE, setup={"carrier_hz": 70e9, "name": "a"}))) as cube:
        assert cube.transmitted is None


@pytest.mark.parametrize("contents", [npz, mat, mat73, h5])
def test_the_axes_of_a_frame_of_one_symbol_are_no_grid(path_of, contents):
    frame, grid = CUBE[:, :1], QPSK[:, :1]
    with open_cube(path_of(contents(cube=frame, f=np.arange(float(N)), t=0.5))) as cube:
        assert cube.transmitted is None
    with pytest.raises(InputError, match=r"holds symbols .* beside the cube"):
        open_cube(path_of(contents(cube=frame, symbols=grid)))


def test_attributes_texts_and_scales_are_no_arrays(path_of):
    def change(file):
        file["notes"] = np.array(["by", "hand"], dtype=h5py.string_dtype())
        file["f"] = np.arange(float(N))
        file["f"].make_scale("f")
        file["cube"].dims[0].attach_scale(file["f"])
        file.attrs["carrier_hz"] = 70e9
        file["transmitted"].attrs["unit"] = "1"
        file["cube"].attrs["axes"] = "subcarriers, symbols, P, Q"

    with open_cube(path_of(h5(change, cube=CUBE, transmitted=QPSK))) as cube:
        assert np.array_equal(cube.transmitted, QPSK)


def test_two_arrays_of_one_name_in_an_archive_are_refused(path_of, tmp_path):
    np.save(tmp_path / "cube.npy", CUBE)
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = path_of(members(**{"cube.npy": (tmp_path / "cube.npy").read_bytes()}))
    with pytest.raises(InputError, match="holds cube twice"):
        open_cube(path)


def test_two_variables_of_one_name_in_a_mat_file_are_refused(path_of):
    path = path_of(mat(cube=CUBE))
    path.write_bytes(path.read_bytes() + path.read_bytes()[128:])
    with pytest.raises(InputError, match='Duplicate variable name "cube"'):
        open_cube(path)


@pytest.mark.parametrize("contents", [npz, mat73, zarr_of, h5])
def test_a_grid_alone_may_have_settings_in_groups_beside_it(path_of, contents):
    path = path_of(contents(symbols=QPSK, **{"setup/limits": np.ones((2, 2))}))
    assert np.array_equal(read_grid(path), QPSK)


UNCLEAR_GRIDS = {
    "sparse": mat(tx=csc_array(QPSK), used=np.ones((N, M))),
    "flat": npz(tx=QPSK.ravel(), mask=np.ones((N, M))),
    "parts": npz(re=QPSK.real, im=QPSK.imag.ravel()),
    "in a group": h5(used=np.ones((N, M)), **{"a/tx": QPSK}),
    "of several antennas": npz(tx=np.stack([QPSK, QPSK]), used=np.ones((N, M))),
}


@pytest.mark.parametrize("contents", UNCLEAR_GRIDS.values(), ids=UNCLEAR_GRIDS)
def test_of_what_may_be_the_grid_none_is_guessed(path_of, contents):
    with pytest.raises(InputError, match="may be the transmitted grid; allowed is one array named 'transm"):
        read_grid(path_of(contents))


def test_attributes_are_neither_a_cube_nor_a_grid_that_hides_another(path_of):
    def change(file):
        file.attrs["rotation"], file.attrs["kernel"] = np.eye(3), np.ones((1, 1, 2, 2))

    with open_cube(path_of(h5(change, echo=CUBE))) as cube:
        assert_gives(cube, CUBE)
    assert np.array_equal(read_grid(path_of(h5(change, x=QPSK), "grid")), QPSK)
    with pytest.raises(InputError, match=r"cube@transmitted \(complex128"):
        open_cube(path_of(h5(lambda file: file["cube"].attrs.update(transmitted=QPSK), cube=CUBE)))


def test_a_sparse_cube_hides_no_sparse_grid(path_of):
    contents = mat(cube=csc_array(QPSK), tx=csc_array(QPSK), used=np.ones((N, M)))
    with pytest.raises(InputError, match=r"holds tx \(sparse matrix\) beside the grid"):
        read_grid(path_of(contents))


def test_a_frame_is_told_of_once(path_of, tmp_path):
    (tmp_path / "mini.toml").write_text(MINI)
    scenario = load_scenario(tmp_path / "mini.toml")
    frame = np.ones((128, 56, 8, 8), np.complex64)
    with pytest.warns(InputWarning) as told:
        _ = observe_cube(path_of(h5(cube=frame, raw=frame)), scenario).cross
    assert len(told) == 1


def test_cells_and_objects_beside_a_grid_alone_are_told(path_of):
    for contents, unused in ((mat(x=QPSK, tx=CELL), "tx"), (npz(x=QPSK, t=QPSK.astype(object)), "t")):
        with pytest.warns(InputWarning, match=rf"does not use {unused} \("):
            assert np.array_equal(read_grid(path_of(contents)), QPSK)


def test_the_image_of_a_received_frame_is_that_of_its_echoes(tmp_path):
    """(F X) / X = F: the one point, not one of eighteen."""
    (tmp_path / "mini.toml").write_text(MINI)
    scenario = load_scenario(tmp_path / "mini.toml")
    divided = resource_grid(scenario, scenario.array.positions).reshape(128, 56, 8, 8)
    grid = np.exp(0.5j * np.pi * np.random.default_rng(0).integers(4, size=divided.shape[:2]))
    received = divided * grid[:, :, None, None]
    savemat(tmp_path / "frame.mat", {"cube": received, "transmitted": {"grid": grid}})
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        file["frame/cube"], file["frame/symbols"] = received, grid
        file["frame/transmitted"] = file["frame/symbols"]
    for name in ("frame.mat", "frame.h5"):
        cloud = get_estimator("fft4d").estimate(observe_cube(tmp_path / name, scenario))
        assert np.allclose(cloud.xyz, [[3, 10, 5]], atol=0.1), name

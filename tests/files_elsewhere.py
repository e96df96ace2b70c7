"""Opens the files that `cargo test --test files` writes with other software and compares what they hold.

pip install usd-core pymeshlab trimesh meshio numpy
python tests/files_elsewhere.py target/tmp/files
"""

import json
import pathlib
import sys

import meshio
import numpy
import pymeshlab
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdValidation

folder = pathlib.Path(sys.argv[1])
expected = json.loads((folder / "expected.json").read_text())


def same_points(found, wanted, tolerance):
    found, wanted = numpy.asarray(found, float), numpy.asarray(wanted, float)
    assert found.shape == wanted.shape, (found.shape, wanted.shape)
    assert abs(found - wanted).max() <= tolerance, abs(found - wanted).max()


def same_set(found, wanted, tolerance):
    """Points in any order, for software that merges or sorts."""
    distances = numpy.linalg.norm(numpy.asarray(found)[:, None] - numpy.asarray(wanted)[None], axis=2)
    assert distances.min(0).max() <= tolerance and distances.min(1).max() <= tolerance


def triangle_count(faces):
    return sum(len(face) - 2 for face in faces)


def check_usd(path, want):
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
    to_world = mesh.ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    points = [to_world.Transform(Gf.Vec3d(p)) for p in mesh.GetPointsAttr().Get()]
    same_points(points, want["points"], 1e-6)
    assert list(mesh.GetFaceVertexCountsAttr().Get()) == [len(f) for f in want["faces"]]
    assert list(mesh.GetFaceVertexIndicesAttr().Get()) == sum(want["faces"], [])
    assert UsdGeom.Mesh.ValidateTopology(
        mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), len(points))[0]
    assert mesh.GetSubdivisionSchemeAttr().Get() == want["scheme"]
    assert mesh.GetInterpolateBoundaryAttr().Get() == "edgeAndCorner"
    computed = UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get())
    same_points(mesh.GetExtentAttr().Get(), computed, 1e-6)
    if "creases" in want:
        ends = numpy.reshape(mesh.GetCreaseIndicesAttr().Get(), (-1, 2))
        sharpness = mesh.GetCreaseSharpnessesAttr().Get()
        assert [[*map(int, e), s] for e, s in zip(ends, sharpness)] == want["creases"]
        assert list(mesh.GetCornerIndicesAttr().Get()) == want["corners"]
    if "error" in want:
        error = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("error")
        assert error.GetInterpolation() == "vertex" and list(error.Get()) == want["error"]
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = UsdValidation.ValidationContext(validators).Validate(stage)
    assert not problems, [p.GetErrorAsString() for p in problems]


def check_pymeshlab(path, want):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    mesh = meshes.current_mesh()
    assert mesh.face_number() == triangle_count(want["faces"]), mesh.face_number()
    same_set(mesh.vertex_matrix(), want["points"], 1e-6)


def check_trimesh(path, want):
    mesh = trimesh.load(path, force="mesh", process=False)
    assert len(mesh.faces) == triangle_count(want["faces"])
    same_set(mesh.vertices, want["points"], 1e-6)
    assert abs(mesh.area - 6) < 1e-6


def check_meshio(path, want):
    mesh = meshio.read(path)
    assert sum(len(block.data) * (block.data.shape[1] - 2) for block in mesh.cells) == triangle_count(want["faces"])
    same_set(mesh.points, want["points"], 1e-6)
    if path.suffix == ".ply":
        assert list(mesh.point_data["error"]) == want["error"]


def check_lines(path, want):
    # meshio ends the program at any element of a PLY file but vertices and faces.
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    mesh = meshes.current_mesh()
    assert mesh.edge_matrix().tolist() == want["edges"]
    same_points(mesh.vertex_matrix(), want["points"], 1e-6)


READERS = {
    ".usda": [check_usd],
    ".glb": [check_trimesh],
    ".obj": [check_pymeshlab, check_trimesh, check_meshio],
    ".ply": [check_pymeshlab, check_trimesh, check_meshio],
    ".stl": [check_pymeshlab, check_trimesh, check_meshio],
    # meshio reads triangles only from OFF.
    ".off": [check_pymeshlab, check_trimesh],
}

for name, want in expected.items():
    path = folder / name
    for check in [check_lines] if "edges" in want else READERS[path.suffix]:
        check(path, want)
        print(f"{name}: {check.__name__[6:]} agrees")

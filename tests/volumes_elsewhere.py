"""Opens the files that `cargo test --test volume_files` writes with other software, evaluates the curved cells there at random points, and
compares with the map that bent them.

pip install vtk gmsh mfem meshio numpy
python tests/volumes_elsewhere.py target/tmp/volumes
"""

import itertools
import json
import pathlib
import sys

import gmsh
import meshio
import mfem.ser as mfem
import numpy
import vtk
from vtk.util.numpy_support import vtk_to_numpy

folder = pathlib.Path(sys.argv[1])
expected = json.loads((folder / "expected.json").read_text())
random = numpy.random.default_rng(0)
AXES = {"tetrahedron": (1, 2, 3), "prism": (1, 2, 3), "hexahedron": (1, 3, 4)}
SHAPES = list(AXES)


def bent(p, degree):
    """The map of tests/volume_files.rs."""
    x, y, z = p
    q = numpy.array(p, float)
    if degree >= 2:
        q = q + 0.1 * numpy.array([y * z, x * x - z, x * y])
    if degree >= 3:
        q = q + 0.05 * numpy.array([z**3, x * y * z, x * x * y])
    return q


def determinant_of_bent(p, degree):
    """Of the derivative of the map."""
    x, y, z = p
    derivative = numpy.eye(3)
    if degree >= 2:
        derivative += 0.1 * numpy.array([[0, z, y], [2 * x, 0, -1], [y, x, 0]])
    if degree >= 3:
        derivative += 0.05 * numpy.array([[0, 0, 3 * z * z], [y * z, x * z, x * y], [2 * x * y, x * x, 0]])
    return numpy.linalg.det(derivative)


def straight(shape, corners, u):
    corners = numpy.asarray(corners)
    return corners[0] + numpy.asarray(u) @ (corners[list(AXES[shape])] - corners[0])


def random_points(shape, count=4):
    """Reference coordinates inside a cell."""
    points = []
    while len(points) < count:
        u = random.random(3)
        if shape == "hexahedron" or (shape == "prism" and u[0] + u[1] < 1) or u.sum() < 1:
            points.append(u)
    return points


def compare(shape, corners, order, evaluate, tolerance):
    """Whether a cell is the bent one everywhere."""
    worst = 0
    for u in random_points(shape):
        worst = max(worst, abs(evaluate(u) - bent(straight(shape, corners, u), order)).max())
    assert worst <= tolerance, (shape, order, worst)
    return worst


def tolerance_of(order):
    """Interpolation at equispaced points amplifies rounding about as 2^order."""
    return 1e-14 * 2**order


def check_vtk(path, want):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    assert grid.GetNumberOfCells() == len(want["cells"])
    worst = 0
    for c, (shape, corners) in enumerate(want["cells"]):
        cell = grid.GetCell(c)
        count = cell.GetNumberOfPoints()

        def evaluate(u):
            x, weights, sub = [0.0] * 3, [0.0] * count, vtk.reference(0)
            cell.EvaluateLocation(sub, u, x, weights)
            return numpy.array(x)

        worst = max(worst, compare(shape, corners, want["order"], evaluate, tolerance_of(want["order"])))
    points = vtk_to_numpy(grid.GetPoints().GetData())
    distances = vtk_to_numpy(grid.GetPointData().GetArray("distance"))
    assert abs(numpy.linalg.norm(points, axis=1) - distances).max() < 1e-15 * 10
    assert list(vtk_to_numpy(grid.GetCellData().GetArray("number"))) == list(range(len(want["cells"])))
    return worst


def check_mfem(path, want):
    mesh = mfem.Mesh(str(path), 1, 0)
    assert mesh.GetNE() == len(want["cells"]) and mesh.GetNBE() > 0
    assert (mesh.GetNodalFESpace() is None) == (want["order"] == 1)
    worst = 0
    for c, (shape, corners) in enumerate(want["cells"]):
        transformation = mesh.GetElementTransformation(c)

        def evaluate(u):
            point = mfem.IntegrationPoint()
            point.Set3(*u)
            return numpy.array(transformation.Transform(point))

        worst = max(worst, compare(shape, corners, want["order"], evaluate, tolerance_of(want["order"])))
    return worst


def gmsh_point(shape, u):
    """Gmsh's reference hexahedron is [-1, 1] cubed, its prism [-1, 1] high."""
    u = numpy.array(u)
    along = {"hexahedron": [True] * 3, "prism": [False, False, True], "tetrahedron": [False] * 3}[shape]
    return numpy.where(along, 2 * u - 1, u)


GMSH_SCALE = {"hexahedron": 8, "prism": 2, "tetrahedron": 1}


def check_gmsh(path, want):
    gmsh.open(str(path))
    # Gmsh evaluates through monomials, which loses two digits more an order.
    gmsh_tolerance = 1e-13 * 4 ** want["order"]
    worst = 0
    for shape in SHAPES:
        cells = [(c, corners) for c, (s, corners) in enumerate(want["cells"]) if s == shape]
        if not cells:
            continue
        kind = gmsh.model.mesh.getElementType(shape, want["order"])
        tags, _ = gmsh.model.mesh.getElementsByType(kind)
        assert list(tags) == [c + 1 for c, _ in cells]
        # Gmsh's bounds take minutes beyond order 4.
        bounded = want["order"] <= 4
        smallest = gmsh.model.mesh.getElementQualities(tags, "minDetJac") if bounded else [None] * len(tags)
        for (c, corners), tag, least in zip(cells, tags, smallest):

            def evaluate(u):
                return numpy.array(gmsh.model.mesh.getJacobian(tag, gmsh_point(shape, u))[2])

            worst = max(worst, compare(shape, corners, want["order"], evaluate, gmsh_tolerance))
            if least is None:
                continue
            # The smallest determinant is in the samples up to their spacing, and never above them.
            steps = numpy.linspace(0, 1, 7)
            lattice = [u for u in itertools.product(steps, repeat=3)
                       if shape == "hexahedron" or (u[0] + u[1] <= 1 if shape == "prism" else sum(u) <= 1)]
            corners = numpy.asarray(corners)
            affine = numpy.linalg.det(corners[list(AXES[shape])] - corners[0])
            sampled = min(determinant_of_bent(straight(shape, corners, u), want["order"]) for u in lattice) * affine
            least *= GMSH_SCALE[shape]
            assert sampled - 0.01 <= least <= sampled + 1e-9, (shape, sampled, least)
    return worst


def check_meshio(path, want):
    mesh = meshio.read(path)
    assert sum(len(block.data) for block in mesh.cells) == len(want["cells"])
    count = 0
    for block in mesh.cells:
        shape = {"tetra": "tetrahedron", "wedge": "prism", "hexahedron": "hexahedron"}[block.type.rstrip("0123456789")]
        wanted = [corners for s, corners in want["cells"] if s == shape]
        # VTK numbers the triangles of wedges the other way round, which meshio passes on.
        turned = [0, 2, 1, 3, 5, 4] if shape == "prism" and path.suffix == ".vtu" else slice(None)
        for cell, corners in zip(block.data, wanted):
            found = mesh.points[cell[: len(corners)][turned]]
            wanted_points = [bent(p, want["order"]) for p in corners]
            assert abs(found - wanted_points).max() < 1e-15 * 10
            count += 1
    assert count >= 1
    return 0.0


gmsh.initialize()
gmsh.option.setNumber("General.Verbosity", 2)
READERS = {".vtu": [check_vtk], ".mesh": [check_mfem], ".msh": [check_gmsh]}
for name, want in expected.items():
    path = folder / name
    checks = READERS[path.suffix][:]
    # meshio knows straight cells in VTU, and in MSH those whose node order it shares with VTK or does not touch.
    if want["order"] == 1 and path.suffix in (".vtu", ".msh"):
        checks.append(check_meshio)
    for check in checks:
        try:
            found = check(path, want)
        except Exception as problem:
            raise SystemExit(f"{name}: {check.__name__[6:]}: {problem!r}")
        print(f"{name}: {check.__name__[6:]} agrees within {found:.1e}", flush=True)

"""Drawings: sound meshes that move with the joints; the PSM's parallelogram closes."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import robots

ARMS = ("psm", "point", "panda", "ur5")
MOST_TRIANGLES = 65_000


@pytest.fixture(scope="module", params=ARMS)
def arm(request):
    return robots.load(request.param)


@pytest.fixture(scope="module")
def psm():
    return robots.load("psm")


def rotation(wxyz):
    """Rotation matrix of a unit quaternion, by the textbook formula."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def drawn(arm, q, name):
    """A body's vertices in the base frame, float64."""
    row = dict(zip((b.name for b in arm.bodies), arm.placements(q), strict=True))[name]
    body = next(b for b in arm.bodies if b.name == name)
    return body.vertices.astype(np.float64) @ rotation(row[:4]).T + row[4:]


def at_frame(arm, q, frame, point):
    """A point of a frame in the base frame, through the placements."""
    i = [b.frame for b in arm.bodies].index(frame)
    row = arm.placements(q)[i]
    return rotation(row[:4]) @ point + row[4:]


def random_q(arm, rng):
    return rng.uniform(arm.lower, arm.upper)


def test_bodies_are_sound_and_few(arm):
    names = [b.name for b in arm.bodies]
    assert len(set(names)) == len(names)
    assert 0 < sum(len(b.faces) for b in arm.bodies) < MOST_TRIANGLES
    for body in arm.bodies:
        assert body.vertices.dtype == np.float32
        assert body.vertices.shape[1] == 3
        assert np.isfinite(body.vertices).all()
        assert np.abs(body.vertices).max() < 2.0
        assert body.faces.dtype == np.uint32
        assert body.faces.shape[1] == 3
        assert body.faces.max() < len(body.vertices)
        assert all(isinstance(c, int) and 0 <= c <= 255 for c in body.color)
        assert not body.vertices.flags.writeable
        assert not body.faces.flags.writeable
        with pytest.raises(dataclasses.FrozenInstanceError):
            body.color = (0, 0, 0)


@pytest.mark.parametrize("name", ["psm", "point"])
def test_own_solids_are_closed_and_face_outwards(name):
    for body in robots.load(name).bodies:
        mesh = trimesh.Trimesh(body.vertices.astype(np.float64), body.faces, process=False)
        mesh.merge_vertices(merge_norm=True, digits_vertex=9)
        # Closed: every directed edge has its opposite, however many solids share that edge.
        edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        forth = {
            tuple(e): n for e, n in zip(*np.unique(edges, axis=0, return_counts=True), strict=True)
        }
        assert all(forth.get((b, a)) == n for (a, b), n in forth.items()), body.name
        count, solid = connected_components(
            coo_array((np.ones(len(edges)), edges.T), shape=(len(mesh.vertices),) * 2)
        )
        assert count > 0
        a, b, c = np.moveaxis(mesh.triangles, 1, 0)
        six_volumes = np.bincount(
            solid[mesh.faces[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c)), count
        )
        assert np.all(six_volumes > 0.0), body.name


def test_placements_are_unit_poses_one_a_body_and_bodies_move(arm):
    rng = np.random.default_rng(21)
    first, second = (arm.placements(random_q(arm, rng)) for _ in range(2))
    assert first.shape == (len(arm.bodies), 7)
    np.testing.assert_allclose(np.linalg.norm(first[:, :4], axis=1), 1.0, atol=1e-12)
    for body, a, b in zip(arm.bodies, first, second, strict=True):
        assert np.array_equal(a, b) == (body.frame == "universe"), body.name


def test_each_joint_moves_the_bodies_beyond_it_rigidly_about_its_axis(arm):
    """The last body follows the tip: its placement relative to the tip never changes."""
    rng = np.random.default_rng(22)
    relative = []
    for _ in range(20):
        q = random_q(arm, rng)
        row = arm.placements(q)[[b.frame for b in arm.bodies].index(arm.joints[-1])]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation(row[:4]), row[4:]
        relative.append(np.linalg.inv(T) @ arm.tip(q).homogeneous)
    np.testing.assert_allclose(relative, np.broadcast_to(relative[0], (20, 4, 4)), atol=1e-12)


def pins(q):
    """A, B, C of the parallelogram in the base frame, from the published formulas."""
    u = np.array([0.0, -1.0, 0.0])
    w = np.array([-np.sin(q[0]), 0.0, np.cos(q[0])])
    phi = 0.2904 - q[1]
    A = 0.516 * u
    B = A + 0.150 * (np.sin(phi) * u + np.cos(phi) * w)
    return A, B, B - 0.516 * u


def test_the_parallelogram_closes_on_its_pins(psm):
    rng = np.random.default_rng(23)
    # The carrier is a solid of the pitch joint: its pin is fixed there, wherever C is at q = 0.
    R = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    C_pitch = R.T @ pins(np.zeros(6))[2]
    for _ in range(100):
        q = random_q(psm, rng)
        A, B, C = pins(q)
        for frame, point, pin_there in (
            ("crank", [0, 0, 0], A),
            ("crank", [0, 0, 0.150], B),
            ("upper_rod", [0, 0, 0], B),
            ("upper_rod", [0, 0.516, 0], C),
            ("pitch", C_pitch, C),
            ("yoke", [0, -0.516, 0], A),
        ):
            np.testing.assert_allclose(at_frame(psm, q, frame, point), pin_there, atol=1e-12)
        # The lower rod runs between the same fraction of the crank and of the carrier.
        for ends, at in ((("crank", [0, 0, 0.085]), [0, 0, 0]), (("pitch", None), [0, 0.516, 0])):
            point = ends[1] if ends[1] is not None else 0.085 / 0.150 * C_pitch
            np.testing.assert_allclose(
                at_frame(psm, q, ends[0], point), at_frame(psm, q, "lower_rod", at), atol=1e-12
            )


def test_the_drawn_links_have_their_eyes_on_the_pins(psm):
    """The solids, not just their frames: each link reaches its pins by its eyes' radii."""
    for name, eye_start, eye_end, length, axis in (
        ("crank", 0.026, 0.020, 0.150, 2),
        ("upper_rod", 0.019, 0.019, 0.516, 1),
        ("lower_rod", 0.010, 0.010, 0.516, 1),
    ):
        vertices = next(b for b in psm.bodies if b.name == name).vertices[:, axis]
        assert vertices.min() == pytest.approx(-eye_start, abs=1e-4)
        assert vertices.max() == pytest.approx(length + eye_end, abs=1e-4)


def test_the_shaft_passes_through_the_remote_centre(psm):
    rng = np.random.default_rng(24)
    for _ in range(50):
        vertices = drawn(psm, random_q(psm, rng), "shaft")
        center = vertices.mean(axis=0)
        _, _, directions = np.linalg.svd(vertices - center, full_matrices=False)
        distance = np.linalg.norm(np.cross(center, directions[0]))
        assert distance < 1e-6
        radial = np.linalg.norm(np.cross(vertices - center, directions[0]), axis=1)
        assert radial.max() == pytest.approx(0.00835 / 2, abs=1e-6)


def test_the_blades_point_is_the_tip(psm):
    rng = np.random.default_rng(25)
    for _ in range(20):
        q = random_q(psm, rng)
        tip = psm.tip(q)
        vertices = drawn(psm, q, "cutter_blade")
        assert np.linalg.norm(vertices - tip.translation, axis=1).min() < 1e-6
        # Nothing of the tool reaches past it.
        for name in ("cutter_blade", "cutter_hub", "cutter_point"):
            ahead = (drawn(psm, q, name) - tip.translation) @ tip.rotation[:, 2]
            assert ahead.max() < 1e-6


def test_the_needles_point_is_the_tip():
    arm = robots.load("point")
    q = np.array([0.1, -0.05, 0.2])
    vertices = np.vstack([drawn(arm, q, b.name) for b in arm.bodies])
    lowest = vertices[np.argmin(vertices[:, 2])]
    np.testing.assert_allclose(lowest, arm.tip(q).translation, atol=1e-6)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_the_probe_ends_at_the_tip_and_starts_at_its_holder(name):
    arm = robots.load(name)
    q = random_q(arm, np.random.default_rng(7))
    probe = drawn(arm, q, "probe")
    tip = arm.tip(q)
    along = (probe - tip.translation) @ tip.rotation[:, 2]
    # Nothing beyond the tip, the point is the tip, and the other end is at hand or flange.
    assert along.max() == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(probe - tip.translation, axis=1).min() < 2e-4
    assert -0.116 < along.min() <= -0.0999
    holder = tip.translation - 0.1 * tip.rotation[:, 2]
    others = np.vstack([drawn(arm, q, b.name) for b in arm.bodies if b.name != "probe"])
    assert np.linalg.norm(others - holder, axis=1).min() < 0.03


def test_the_urdf_drawings_agree_with_pinocchios_own_meshes():
    """Same extent, link by link, as the meshes Pinocchio itself loads (through Assimp)."""
    import pinocchio as pin

    from robots import urdf

    for name, file in (("panda", urdf._PANDA), ("ur5", urdf._UR5)):
        arm = robots.load(name)
        model = urdf._model(file)
        visual = pin.buildGeomFromUrdf(
            model, urdf._path(file), pin.GeometryType.VISUAL, package_dirs=[str(urdf._share())]
        )
        data = model.createData()
        q = pin.neutral(model)
        q[: len(arm.neutral)] = arm.neutral
        pin.forwardKinematics(model, data, q)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for shape in visual.geometryObjects:
            T = data.oMi[shape.parentJoint] * shape.placement
            points = shape.geometry.vertices() @ T.rotation.T + T.translation
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        ours = np.vstack([drawn(arm, arm.neutral, b.name) for b in arm.bodies if b.name != "probe"])
        # Thinning rounds corners a little.
        np.testing.assert_allclose(ours.min(axis=0), low, atol=2e-3)
        np.testing.assert_allclose(ours.max(axis=0), high, atol=2e-3)
        assert len({b.color for b in arm.bodies}) >= 3

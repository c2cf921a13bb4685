"""What the page shows of several structures: the list, the banner, the read-outs, the inspector."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import viser

from app.judges import boxes
from app.judges.nearest import gaps
from app.recording.playback import Moment
from app.scene.picking import main_structure
from app.session import Session
from app.structure import Structure
from app.view import palette
from app.view.drawing import anatomy, fixture
from app.view.drawing.labels import Labels
from app.view.inspector import descriptions
from app.view.inspector.inspection import Inspector, Request, Subject
from app.view.source import Source
from app.view.tabs import readouts, structure_list
from app.view.tabs.measuring import Measuring
from tests.support import structured
from tests.support.headless import wait_until


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = structured.balls(tmp_path_factory.mktemp("balls"))
    with Session(structured.options(folder, robot="psm")) as running:
        yield running


@pytest.fixture(scope="module")
def pressed(session: Session) -> Moment:
    """The tool pressed onto the nerve, structure 2."""
    start = session.scene.T_base_start
    middle = session.scene.surfaces[2].vertices.mean(axis=0)
    session.drive(pin.SE3(start.rotation, middle))
    source = Source(session)

    def holding() -> bool:
        return structure_list._holding(source.now()) == [2]

    wait_until(holding)
    return source.shown


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    running = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield running
    running.stop()


def test_the_list_has_a_row_for_each(pressed: Moment) -> None:
    structures = list(pressed.options.anatomy)
    structures[1] = replace(structures[1], name="a<b>&'c", guarded=False)
    rows = structure_list._rows(structures, [True, True, False, True], 2)
    found = re.findall(r"<tr class='vf-s(\d+) ([^']*)'>(.*?)</tr>", rows)
    assert [int(number) for number, _, _ in found] == [0, 1, 2, 3]
    assert ["vf-off" in marks for _, marks, _ in found] == [False, True, False, False]
    assert ["vf-chosen" in marks for _, marks, _ in found] == [False, False, True, False]
    assert "<b>" not in rows
    assert "a&lt;b&gt;&amp;&#x27;c" in rows
    for k, (_, _, row) in enumerate(found):
        for order in ("eye", "guard", "choose"):
            assert f"data-vf-order='{order} {k}'" in row
        assert palette.css(palette.structure_colour(structures[k], k)) in row
    assert "<td>2</td>" in found[3][2]  # the margin of the vessel [mm]
    pressed_buttons = [re.findall(r"aria-pressed='(\w+)'", row) for _, _, row in found]
    assert [eye for eye, _, *_ in pressed_buttons] == ["true", "true", "false", "true"]


def test_distances_are_those_of_the_tool_and_the_holder_is_marked(pressed: Moment) -> None:
    scene, telemetry = pressed.scene, pressed.telemetry
    found = structure_list._distances(pressed)
    for surface, distance in zip(scene.surfaces, found, strict=True):
        truth = gaps(boxes.of(surface), scene.arm, telemetry.q).min()
        assert distance == pytest.approx(truth, abs=1e-9)
    margin, standoff = structured.MARGINS["nerve"], pressed.options.standoff
    assert margin + standoff - 1e-9 <= found[2] < margin + 5e-4
    state = structure_list._state(found, structure_list._holding(pressed))
    assert f".vf-s2 .vf-distance::after{{content:'{1e3 * found[2]:.2f}'}}" in state
    assert ".vf-s2 .vf-name{box-shadow" in state
    assert ".vf-s1 .vf-name{" not in state
    # A structure that holds the tip alone has the tip's distance.
    tip_only = replace(pressed, options=replace(pressed.options, structures=tuple(
        replace(own, guard="tip") for own in pressed.options.structures
    )))  # fmt: skip
    assert pressed.telemetry.step is not None
    p_tip = np.array(pressed.telemetry.step.tip.translation)
    assert structure_list._distances(tip_only)[1] == scene.surfaces[1].nearest(p_tip)[0]


def test_banner_and_readouts_name_the_structure(pressed: Moment) -> None:
    extras = Measuring().measure(pressed, 0, "")
    assert extras.structures == ("cube", *structured.NAMES)
    assert extras.where is not None
    assert extras.where.structure == "nerve"
    banner = readouts.banner(pressed.telemetry, pressed.options, extras, False)
    assert "nerve holds the " in banner
    table = re.sub(r"<[^>]*>", "|", readouts.readouts(pressed.telemetry, pressed.options, extras))
    assert re.search(r"held by\|+nerve", table)
    assert re.search(r"nearest structure\|+nerve", table)
    # With one structure nothing is named.
    alone = replace(extras, structures=())
    assert "The fixture holds" in readouts.banner(pressed.telemetry, pressed.options, alone, False)
    assert "held by" not in readouts.readouts(pressed.telemetry, pressed.options, alone)


def test_the_inspector_explains_the_structure_that_holds_the_tool(pressed: Moment) -> None:
    scene, step, options = pressed.scene, pressed.telemetry.step, pressed.options
    assert step is not None
    p_tip = np.array(step.tip.translation)
    surfaces = scene.surfaces
    assert main_structure(surfaces, step, [p_tip] * len(surfaces), None) == 2
    assert main_structure(surfaces, step, [p_tip] * len(surfaces), 3) == 3
    subject = Subject(
        surfaces[2], p_tip, step.radius, options, options.rule, scene, step,
        axes=scene.arm.axes(step.q), fixture=2, structure="nerve", margin=1e-3,
    )  # fmt: skip
    found = Inspector().inspect(Request(subject, True, False))
    assert step.planes.fixtures is not None
    assert len(found.planes) == int((step.planes.fixtures == 2).sum())
    assert found.pushes == pytest.approx(float(step.multipliers.sum()))
    main = found.main_triangle()
    assert 0 <= main < len(surfaces[2].faces)
    assert found.push(main)[0] > 0.0
    assert "Structure: nerve" in descriptions.structure(found)
    assert descriptions.structure(replace(found, subject=replace(subject, structure=""))) == ""
    # The region is cut by the planes of all structures.
    other = Inspector().inspect(Request(replace(subject, surface=surfaces[3], fixture=3), True, 0))
    assert found.region is not None
    assert other.region is not None
    assert other.region.share == found.region.share


def test_planes_and_triangles_are_drawn_where_their_structure_is(
    pressed: Moment, server: viser.ViserServer
) -> None:
    drawing = fixture.FixtureDrawing(server.scene, Labels(server))
    drawing.frame(pressed, {})
    assert drawing._blocks.visible
    assert " at nerve: takes " in drawing._blocks.text
    step = pressed.telemetry.step
    assert step is not None
    rows, corners = fixture._triangles(
        step.planes, pressed.scene.surfaces, np.arange(len(step.planes))
    )
    assert step.planes.fixtures is not None
    for k, three in zip(rows, corners, strict=True):
        surface = pressed.scene.surfaces[step.planes.fixtures[k]]
        np.testing.assert_array_equal(
            three, surface.vertices[surface.faces[step.planes.triangles[k]]]
        )
    assert len(rows) == len(step.planes)
    # A tick of before a structure was switched off is drawn without what is not known.
    fewer = replace(pressed, options=replace(pressed.options, guarded=False))
    drawing.frame(fewer, {})


def test_each_structure_has_its_look_and_its_switch(
    pressed: Moment, server: viser.ViserServer
) -> None:
    layer = anatomy.Anatomy(server.scene)
    layer.set_scene(pressed.scene)
    nodes: list[Any] = [drawn.mesh for drawn in layer._drawn]
    assert [node.name for node in nodes] == [
        "/anatomy/mesh", *(f"/anatomy/structure{k}" for k in (1, 2, 3)),
    ]  # fmt: skip
    assert [tuple(node.color) for node in nodes] == [
        palette.structure_colour(own, k) for k, own in enumerate(pressed.options.anatomy)
    ]
    layer.show_structure(2, False)
    assert [node.visible for node in nodes] == [True, True, False, True]
    assert not layer.shows(2)
    layer.show(False)
    assert not any(node.visible for node in nodes)
    layer.show(True)
    looks = list(pressed.options.structures)
    looks[0] = replace(looks[0], colour="#010203", opacity=0.5)
    changed = replace(pressed, options=replace(pressed.options, structures=tuple(looks)))
    layer.frame(changed, {})
    assert tuple(nodes[1].color) == (1, 2, 3)
    assert [node.opacity for node in nodes] == [None, 0.5, None, None]
    layer.set_translucent(True)
    assert {node.opacity for node in nodes} == {anatomy.TRANSLUCENT}
    layer.set_scene(replace(pressed.scene, version=2))  # the same files: switches stay
    assert not layer.shows(2)
    layer.set_scene(replace(pressed.scene, version=3, structures=(), options=replace(
        pressed.scene.options, structures=()
    )))  # fmt: skip
    assert len(layer._drawn) == 1
    layer.set_translucent(False)


@pytest.mark.parametrize(
    ("text", "number"),
    [("3: nerve", 3), ("12", 12), ("", -1), ("-1", -1), ("x", -1), ("9" * 9, -1)],
)
def test_the_number_of_an_order(text: str, number: int) -> None:
    assert structure_list._number_of(text) == number


def test_a_structure_without_a_colour_has_one_of_the_page() -> None:
    colours = [palette.structure_colour(Structure("a.stl"), k) for k in range(9)]
    assert colours[0] == palette.BONE
    assert len(set(colours)) == 9
    assert palette.structure_colour(Structure("a.stl", colour="#0a0b0c"), 3) == (10, 11, 12)

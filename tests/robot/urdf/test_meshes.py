"""Where meshes may come from: everything allowed is found, nothing else is."""

import os

import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import RobotInvalid, Status
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.urdf.nearby_files import enclosing_folders

PANDA_MESH = f"{CATALOG_PACKAGE}/robots/panda_description/meshes/collision/link0.stl"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A workspace with a package, an URDF in it, and a mesh outside of everything."""
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    for name in ("ws/arm/meshes/a b.stl", "ws/arm/urdf/near.obj", "ws/other/o.dae", "outside/secret.stl"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("solid")
    return tmp_path


def refused(resolver, uri):
    with pytest.raises(RobotInvalid) as caught:
        resolver.resolve(uri)
    error = caught.value
    assert error.code is Status.ROBOT_INVALID
    assert uri in error.message
    assert error.details["uri"] == uri
    for allowed in error.details.get("allowed", []):
        assert allowed in error.message
    return error


def test_the_wire_reads_the_catalog_and_what_is_configured(home):
    real = (catalog_share() / PANDA_MESH).resolve()
    wire = MeshResolver.for_wire()
    assert wire.resolve(f"package://{PANDA_MESH}") == real
    assert wire.resolve(f"package:///{PANDA_MESH}") == real
    assert wire.resolve(str(real)) == real
    refused(wire, "package://arm/meshes/a b.stl")
    configured = MeshResolver.for_wire([home / "ws"])
    assert configured.resolve("package://arm/meshes/a b.stl") == home / "ws/arm/meshes/a b.stl"
    assert configured.resolve("model://arm/meshes/a b.stl") == home / "ws/arm/meshes/a b.stl"


@pytest.mark.parametrize(
    "uri",
    [
        "{home}/outside/secret.stl",
        "file://{home}/outside/secret.stl",
        "file:///../../../../../../../..{home}/outside/secret.stl",
        "package://arm/../../outside/secret.stl",
        "package://../outside/secret.stl",
        f"package://{CATALOG_PACKAGE}/../../../../../../../../../../../..{{home}}/outside/secret.stl",
    ],
)
def test_nothing_outside_is_read_whether_it_exists_or_not(home, uri):
    wire = MeshResolver.for_wire([home / "ws"])
    present = refused(wire, uri.format(home=home)).message
    absent = refused(wire, uri.format(home=home).replace("secret", "absent")).message
    assert "outside what is allowed" in present
    assert present.replace("secret", "absent") == absent


def test_links_that_lead_outside_are_refused_and_links_inside_followed(home):
    (home / "ws/arm/out.stl").symlink_to(home / "outside/secret.stl")
    (home / "ws/arm/hop").symlink_to(home / "outside")
    (home / "ws/arm/in.stl").symlink_to(home / "ws/other/o.dae")
    wire = MeshResolver.for_wire([home / "ws"])
    assert "a link that leads outside" in refused(wire, "package://arm/out.stl").message
    assert "a link that leads outside" in refused(wire, "package://arm/hop/secret.stl").message
    assert wire.resolve("package://arm/in.stl") == home / "ws/other/o.dae"
    assert MeshResolver.for_wire([home / "ws", home / "outside"]).resolve("package://arm/out.stl").name == "secret.stl"


def test_an_allowed_folder_may_itself_be_a_link(home):
    (home / "alias").symlink_to(home / "ws")
    assert MeshResolver.for_wire([home / "alias"]).resolve("package://other/o.dae") == home / "ws/other/o.dae"


def test_a_file_reads_beside_it_and_from_its_package(home):
    urdf = home / "ws/arm/urdf/arm.urdf"
    mesh = home / "ws/arm/meshes/a b.stl"
    alone = MeshResolver.for_file(urdf)
    assert alone.resolve("near.obj") == home / "ws/arm/urdf/near.obj"
    assert alone.resolve("file://near.obj") == home / "ws/arm/urdf/near.obj"
    assert alone.resolve("../meshes/a b.stl") == mesh
    assert alone.resolve("package://arm/meshes/a b.stl") == mesh
    assert alone.warnings() == []
    (home / "ws/arm/package.xml").write_text("<package>\n <name> arm_description </name></package>")
    packaged = MeshResolver.for_file(urdf)
    for uri in (
        "../meshes/a b.stl",
        "package://arm/meshes/a b.stl",
        "package://arm_description/meshes/a b.stl",
        f"file://{home}/ws/arm/meshes/a%20b.stl",
    ):
        assert packaged.resolve(uri) == mesh
    assert packaged.resolve("package://other/o.dae") == home / "ws/other/o.dae"  # it lies beside the package
    assert packaged.warnings() == []
    assert "outside" in refused(packaged, "../../../outside/secret.stl").message
    assert "outside" in refused(packaged, f"{home}/outside/secret.stl").message


def file_with(path, content="solid"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    "uri",
    [
        "package://arm_of_another_name/meshes/visual/link.stl",
        "package://visual/link.stl",
        "model://deep/down/visual/LINK.STL",
        "file:///data/elsewhere/src/arm/meshes/visual/link.stl",
        "/data/elsewhere/src/arm/visual/Link.STL",
        "file://C:\\robots\\visual\\link.stl",
        "../../../../visual/link.stl",
        "visual/link.stl",
    ],
)
def test_a_mesh_next_door_is_taken_by_the_longest_end_of_its_path(home, uri):
    mesh = file_with(home / "ws/arm/meshes/visual/link.stl", "visual")
    file_with(home / "ws/arm/meshes/collision/link.stl", "collision")
    file_with(home / "ws/other/visual/link.stl", "of another robot, farther away")
    resolver = MeshResolver.for_file(home / "ws/arm/urdf/arm.urdf")
    assert resolver.resolve(uri) == mesh
    (said,) = resolver.warnings()
    assert repr(uri) in said
    assert repr(str(mesh)) in said


def test_a_mesh_of_another_robot_is_not_taken_but_its_package_is_found_deeper(home):
    """Beside the robot's package only a path with the package's name counts; in a given folder all after the name."""
    mesh = file_with(home / "ws/group/tool/meshes/base.stl")
    urdf = file_with(home / "ws/arm/urdf/arm.urdf")
    resolver = MeshResolver.for_file(urdf)
    refused(resolver, "package://arm/meshes/base.stl")
    refused(resolver, "package://arm/base.stl")
    refused(resolver, "/data/elsewhere/meshes/base.stl")
    assert resolver.resolve("package://tool/meshes/BASE.stl") == mesh
    given = MeshResolver.for_file(urdf, [home / "ws/group/tool"])
    assert given.resolve("package://arm/meshes/base.stl") == mesh
    refused(given, "package://arm/meshes/visual/base.stl")


def test_different_files_are_refused_with_their_list_and_equal_ones_are_one(home):
    first = file_with(home / "ws/arm/meshes/left/hand.stl", "hand")
    second = file_with(home / "ws/arm/meshes/right/hand.stl", "another")
    urdf = home / "ws/arm/urdf/arm.urdf"
    said = refused(MeshResolver.for_file(urdf), "package://nowhere/hand.stl").message
    assert str(first) in said
    assert str(second) in said
    assert "`package_dirs`" in said
    second.write_text("hand")
    assert MeshResolver.for_file(urdf).resolve("package://nowhere/hand.stl") == first
    (home / "ws/arm/meshes/left/Hand.stl").write_text("a third")
    assert MeshResolver.for_file(urdf).resolve("package://nowhere/hand.stl") == first  # letters as they are come first


def test_a_package_is_found_by_its_manifest_and_two_of_one_name_are_told(home):
    mesh = file_with(home / "ws/some/folder/m.stl", "one")
    file_with(home / "ws/some/folder/package.xml", "<package><name>robot_description</name></package>")
    urdf, uri = home / "ws/arm/urdf/arm.urdf", "package://robot_description/m.stl"
    alone = MeshResolver.for_file(urdf)
    assert alone.resolve(uri) == mesh
    assert alone.warnings() == []
    assert alone.package_folder("robot_description") == mesh.parent
    assert alone.package_folder("nowhere") is None
    other = file_with(home / "ws/else/m.stl", "two")
    file_with(home / "ws/else/package.xml", "<package><name>robot_description</name></package>")
    twice = MeshResolver.for_file(urdf)
    found = twice.resolve(uri)
    (said,) = twice.warnings()
    assert "two packages are called 'robot_description'" in said
    assert {str(found), str(other), str(mesh)} == {str(other), str(mesh)}
    assert str(mesh) in said
    assert str(other) in said


def test_the_search_ends_at_the_repository_the_package_and_the_home_folder(home, monkeypatch):
    urdf = home / "user/ws/src/arm/urdf/arm.urdf"
    folder = urdf.parent
    folder.mkdir(parents=True)
    assert enclosing_folders(folder) == [folder, *list(folder.parents)[:3]]
    file_with(home / "user/ws/src/arm/package.xml", "<package/>")
    assert enclosing_folders(folder)[-1] == home / "user/ws/src"
    (home / "user/ws/.git").mkdir()
    assert enclosing_folders(folder)[-1] == home / "user/ws"
    for name, last in (("user/ws/src", "user/ws/src/arm"), ("user/ws/src/arm", "user/ws/src/arm/urdf")):
        monkeypatch.setattr("pathlib.Path.home", lambda name=name: home / name)
        assert enclosing_folders(folder)[-1] == home / last
    for own in ("user/ws/src/arm/urdf", "user/ws/src/arm/urdf/below"):
        monkeypatch.setattr("pathlib.Path.home", lambda own=own: home / own)
        assert enclosing_folders(folder) == []
    file_with(folder / "below" / "deep" / "m.stl")
    refused(MeshResolver.for_file(urdf), "package://nowhere/m.stl")


def test_a_search_that_reads_too_much_is_given_up_and_says_so(home, monkeypatch):
    mesh = file_with(home / "ws/arm/meshes/m.stl")
    for number in range(30):
        file_with(home / f"ws/arm/meshes/{number}.txt")
    urdf = home / "ws/arm/urdf/arm.urdf"
    monkeypatch.setattr("guidefield.robot.urdf.nearby_files.MAX_ENTRIES", 20)
    assert "too much to search" in refused(MeshResolver.for_file(urdf), "package://nowhere/m.stl").message
    assert MeshResolver.for_file(urdf).resolve("../meshes/m.stl") == mesh
    near = file_with(home / "ws/arm/urdf/parts/near.stl")
    assert MeshResolver.for_file(urdf).resolve("package://nowhere/parts/near.stl") == near


def test_the_search_follows_no_link_to_a_folder_and_none_that_leads_outside(home):
    (home / "ws/arm/hop").symlink_to(home / "outside")
    (home / "ws/arm/loop").symlink_to(home / "ws/arm")
    (home / "ws/arm/package.xml").write_text("<package/>")
    urdf = home / "ws/arm/urdf/arm.urdf"
    assert "was not found" in refused(MeshResolver.for_file(urdf), "package://nowhere/secret.stl").message
    (home / "ws/arm/link.stl").symlink_to(home / "outside/secret.stl")
    assert "leads outside" in refused(MeshResolver.for_file(urdf), "package://nowhere/link.stl").message


def test_odd_names_of_files_end_no_search(home):
    mesh = file_with(home / "ws/arm/meshes/m.stl")
    (home / "ws/arm/loop.stl").symlink_to(home / "ws/arm/loop.stl")
    (home / "ws/arm/gone.stl").symlink_to(home / "nowhere")
    odd = home / "ws/arm" / os.fsdecode(b"me\xffshes")
    file_with(odd / "odd.stl")
    resolver = MeshResolver.for_file(home / "ws/arm/urdf/arm.urdf")
    assert resolver.resolve("package://nowhere/m.stl") == mesh
    for uri in (
        "../loop.stl",
        "../gone.stl",
        "package://x/odd.stl",
        "package://x/" + "d/" * 3000 + "n.stl",
        "package://",
    ):
        refused(resolver, uri)
    file_with(odd / "urdf" / "near.stl")
    said = refused(MeshResolver.for_file(odd / "urdf" / "arm.urdf"), "near.stl").message
    assert "isn't UTF-8" in said
    said.encode()


def test_a_file_that_came_with_a_robot_is_no_mesh_if_its_suffix_is_none_of_one(home):
    given = {"package://arm/a.png": home / "outside/secret.stl"}
    said = refused(MeshResolver.for_wire([], given), "package://arm/a.png").message
    assert "'package://arm/a.png' is not a mesh file; one ends in .3mf, .dae" in said


def test_over_the_wire_nothing_is_searched(home, monkeypatch):
    monkeypatch.chdir(home / "ws/arm")
    given = {"package://arm/a.stl": home / "outside/secret.stl"}
    wire = MeshResolver.for_wire([home / "ws"], given)
    assert wire.nearby is None
    assert wire.enclosing == ()
    for uri in (
        "package://other/A.stl",
        "package://nowhere/o.dae",
        "package://arm/meshes/A B.stl",
        "package://arm/o.dae",
        "package://other/O.dae",
        "meshes/a b.stl",
        "../other/o.dae/../../outside/secret.stl",
        "secret.stl",
        "package://arm/A.stl",
    ):
        said = refused(wire, uri).message
        assert str(home) not in said.replace(uri, "")
    assert wire.warnings() == []


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("http://example.org/a.stl", "cannot be fetched"),
        ("ftp://a.stl", "cannot be fetched"),
        ("package://arm/meshes/a.txt", "not a mesh file; one ends in .3mf, .dae"),
        ("package://arm/meshes", "not a mesh file"),
        ("package://arm/.stl", "not a mesh file"),
        ("package://arm/lost.STL", "was not found"),
        (f"package://arm/{'x' * 5000}.stl", "was not found"),
        ("lost.stl", "was not found"),
    ],
)
def test_what_else_is_refused(home, uri, words):
    assert words in refused(MeshResolver.for_wire([home / "ws"]), uri).message


@pytest.mark.parametrize(
    "form", ["package://arm/meshes/{}", "model://arm/meshes/{}", "{}", "file://{home}/ws/arm/meshes/{}"]
)
def test_escapes_in_a_uri_are_read_unless_a_file_is_called_so(home, form):
    blank = home / "ws/arm/meshes/a b.stl"
    resolver = MeshResolver(package_dirs=(home / "ws",), base=home / "ws/arm/meshes")
    assert resolver.resolve(form.format("a%20b.stl", home=home)) == blank
    assert resolver.resolve(form.format("a b.stl", home=home)) == blank
    literal = home / "ws/arm/meshes/a%20b.stl"
    literal.write_text("solid")
    assert resolver.resolve(form.format("a%20b.stl", home=home)) == literal
    refused(resolver, form.format("a%2520b.stl", home=home).replace("%2520", "%252520"))


def test_escapes_are_searched_too_and_lead_nowhere_outside(home):
    urdf = home / "ws/arm/urdf/arm.urdf"
    assert MeshResolver.for_file(urdf).resolve("package://renamed/meshes/a%20b.stl") == home / "ws/arm/meshes/a b.stl"
    wire = MeshResolver.for_wire([home / "ws"])
    assert "outside what is allowed" in refused(wire, "package://arm/%2e%2e/%2e%2e/outside/secret.stl").message
    assert "outside what is allowed" in refused(wire, "package://arm/..%2F..%2Foutside/secret.stl").message


def test_an_error_about_a_missing_mesh_says_what_to_do(home):
    lost = "package://nowhere/lost.stl"
    assert "`meshes` of `Client.store_robot`" in refused(MeshResolver.for_wire(), lost).message
    assert "`package_dirs`" in refused(MeshResolver.for_file(home / "ws" / "arm" / "arm.urdf"), lost).message


PARTS = st.lists(
    st.sampled_from(["..", ".", "arm", "meshes", "outside", "ws", "secret.stl", "a b.stl", "", "%2e%2e"]), max_size=9
)


@settings(max_examples=60)
@given(st.sampled_from(["package://", "file://", "model://", "", "/"]), PARTS)
def test_whatever_is_found_lies_inside(tmp_path_factory, scheme, parts):
    root = tmp_path_factory.getbasetemp() / "confined"
    for name in ("ws/arm/meshes/a b.stl", "outside/secret.stl", "ws/arm/secret.stl"):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("solid")
    resolver = MeshResolver((root / "ws",), base=root / "ws/arm")
    try:
        found = resolver.resolve(scheme + "/".join(parts))
    except RobotInvalid:
        return
    assert found.is_relative_to((root / "ws").resolve())
    assert found.is_file()

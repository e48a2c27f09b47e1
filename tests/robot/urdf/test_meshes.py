"""Where meshes may come from: everything allowed is found, nothing else is."""

import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import RobotInvalid, Status
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share

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
    for allowed in error.details["allowed"]:
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
    alone = MeshResolver.for_file(urdf)
    assert alone.resolve("near.obj") == home / "ws/arm/urdf/near.obj"
    assert alone.resolve("file://near.obj") == home / "ws/arm/urdf/near.obj"
    assert "outside" in refused(alone, "../meshes/a b.stl").message
    assert "not found" in refused(alone, "package://arm/meshes/a b.stl").message
    (home / "ws/arm/package.xml").write_text("<package>\n <name> arm_description </name></package>")
    packaged = MeshResolver.for_file(urdf)
    mesh = home / "ws/arm/meshes/a b.stl"
    for uri in (
        "../meshes/a b.stl",
        "package://arm/meshes/a b.stl",
        "package://arm_description/meshes/a b.stl",
        f"file://{home}/ws/arm/meshes/a%20b.stl",
    ):
        assert packaged.resolve(uri) == mesh
    refused(packaged, "package://other/o.dae")
    refused(packaged, "../../other/o.dae")


def test_package_dirs_hold_packages_or_are_packages(home):
    urdf = home / "ws/arm/urdf/arm.urdf"
    for folder in ("ws", "ws/other"):
        assert MeshResolver.for_file(urdf, [home / folder]).resolve("package://other/o.dae") == home / "ws/other/o.dae"


def test_a_ros_environment_names_package_dirs(home, monkeypatch):
    urdf = home / "elsewhere/arm.urdf"
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{home}/ws")
    assert MeshResolver.for_file(urdf).resolve("package://other/o.dae") == home / "ws/other/o.dae"
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(home / "prefix"))
    (home / "prefix").mkdir()
    (home / "ws").rename(home / "prefix/share")
    assert MeshResolver.for_file(urdf).resolve("package://other/o.dae") == home / "prefix/share/other/o.dae"
    refused(MeshResolver.for_wire(), "package://other/o.dae")


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


def test_an_error_about_a_missing_mesh_says_what_to_do(home):
    lost = "package://nowhere/lost.stl"
    assert "`meshes` of `Client.store_robot`" in refused(MeshResolver.for_wire(), lost).message
    assert "`package_dirs`" in refused(MeshResolver.for_file(home / "ws" / "arm" / "arm.urdf"), lost).message


def test_a_folder_is_no_mesh(home):
    (home / "ws/arm/folder.stl").mkdir()
    assert "was not found" in refused(MeshResolver.for_wire([home / "ws"]), "package://arm/folder.stl").message


PARTS = st.lists(
    st.sampled_from(["..", ".", "arm", "meshes", "outside", "ws", "secret.stl", "a b.stl", "", "%2e%2e"]), max_size=9
)


@settings(deadline=None, max_examples=200)
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

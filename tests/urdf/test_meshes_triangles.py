import pytest

from canopen_control.urdf.meshes import dae_triangles, obj_triangles, stl_triangles

DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<asset><unit meter="0.001"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array count="12">
0 0 0 1000 0 0 1000 1000 0 0 1000 0</float_array></source>

<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{part}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><translate>0 0 2000</translate><rotate>0 0 1 90</rotate>
<node><scale>2 1 1</scale>
<instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes></COLLADA>"""
TRIANGLE = """<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/>
<p>0 0 1 0 2 0</p></triangles>"""
SQUARE = """<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>4</vcount><p>0 1 2 3</p></polylist>"""


def test_collada_is_read_where_its_nodes_put_it_in_metres():
    ((a, b, c),) = dae_triangles(DAE.format(up="Z_UP", part=TRIANGLE).encode())
    assert a == pytest.approx((0, 0, 2))
    assert b == pytest.approx((0, 2, 2))  # scaled, turned, then moved
    assert c == pytest.approx((-1, 2, 2))


def test_y_up_is_turned():
    ((a, b, _),) = dae_triangles(DAE.format(up="Y_UP", part=TRIANGLE).encode())
    assert a == pytest.approx((0, -2, 0))
    assert b == pytest.approx((0, -2, 2))


def test_polygons_become_triangles():
    assert len(dae_triangles(DAE.format(up="Z_UP", part=SQUARE).encode())) == 2
    assert len(obj_triangles(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1/1 2//2 3 -1\n")) == 2


def test_what_is_broken_is_an_error_that_the_reader_knows():
    for text in (b"<COLLADA", DAE.format(up="Z_UP", part=TRIANGLE).replace("#g", "#x").encode()):
        with pytest.raises((ValueError, KeyError, IndexError)):
            dae_triangles(text)
    with pytest.raises(IndexError):
        obj_triangles(b"f 1 2 3\n")


def test_the_text_of_an_stl_is_its_corners():
    text = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n  vertex 1e0 0 0\nvertex 0 1 0\nendloop\n"
    assert stl_triangles(text) == [((0, 0, 0), (1, 0, 0), (0, 1, 0))]
    with pytest.raises(IndexError):
        stl_triangles(b"vertex 1 2\n")

"""The studio in which pictures are drawn: one off-screen window of VTK, its light and its cloth.

Light and material are one fragment program of our own. It computes with linear light, and takes shadow and occlusion
of each vertex from :mod:`runtime.draw.light`: the passes of VTK for both have jagged borders in software.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from pbd.mesh import edges_of
from runtime.draw.light import LitSurface, Rings, directions_about, directions_everywhere, exposure
from runtime.draw.picture_content import Camera, Drawn
from wrinkles.mesh_measures import vertex_normals
from wrinkles.surface import cut_corners, cut_faces

__all__ = ["Studio", "studio"]

BACKGROUND = ((0.50, 0.50, 0.51), (0.74, 0.74, 0.75))  # below, above
# Azimuth from the camera's own direction and elevation [deg]. The key light rakes from the side, so that a fold has a
# bright and a dark flank; the rim light, weaker and without shadow of its own, does so where the key does not reach.
KEY = (-75.0, 38.0)
RIM = (95.0, 25.0)
KEY_RADIUS_DEG = 6.0  # half the angle that it fills: a soft box
KEY_RAYS, SKY_RAYS = 12, 48  # directions that stand for each light
FLOOR_REACH = 1.6  # [m] half the side of the square on the floor that can hold a shadow
FLOOR_CELLS = 128
FLOOR_DARKNESS = 0.75  # of the deepest shadow
FINE_EDGE = 0.016  # meshes are cut until their median edge is shorter, since light is known at vertices [m]
MAX_CUTS = 3
SOFTENING = 2  # times that exposure is smoothed over neighbours

_VERTEX_DECLARATIONS = """//VTK::Normal::Dec
in vec4 exposure;
in float curvature;
in vec2 flatPlace;
out vec4 exposureOut;
out float curvatureOut;
out vec2 flatPlaceOut;
"""
_VERTEX = """//VTK::Normal::Impl
exposureOut = exposure;
curvatureOut = curvature;
flatPlaceOut = flatPlace;
"""
_FRAGMENT_DECLARATIONS = """//VTK::Normal::Dec
in vec4 exposureOut;
in float curvatureOut;
in vec2 flatPlaceOut;

const vec3 KEY = vec3(2.9, 2.8, 2.65);
const vec3 RIM = vec3(0.62, 0.68, 0.78);
const vec3 SKY = vec3(0.26, 0.28, 0.31);
// Grooves are darker and ridges lighter, whichever way they run: light from one side does not show a fold along it.
const float RELIEF = 0.45;
const float RIDGE = 40.0; // [1/m]
const vec3 GROUND = vec3(0.07, 0.068, 0.065);

// Share of a pixel that lines of a period cover, one line in each direction; w is the pixel's width in the pattern.
float lines(vec2 place, float period, float width, vec2 w) {
  vec2 at = abs(fract(place / period + 0.5) - 0.5) * period;
  vec2 cover = clamp((0.5 * (width + w) - at) / w, 0.0, 1.0) * min(width / w, vec2(1.0));
  return max(cover.x, cover.y);
}

// Plain weave from -1 to 1: threads that go over and under each other. It fades before a thread is two pixels wide.
float weave(vec2 place, float period, vec2 w) {
  vec2 phase = 6.2831853 * place / period;
  float seen = clamp(1.6 - 4.0 * max(w.x, w.y) / period, 0.0, 1.0);
  return seen * sin(phase.x) * sin(phase.y);
}
"""
_FRAGMENT = """
  vec3 eye = cameraParallel == 1 ? vec3(0.0, 0.0, 1.0) : normalize(-vertexVC.xyz);
  vec3 n = normalVCVSOutput;
  vec2 open = gl_FrontFacing ? exposureOut.xy : exposureOut.zw; // of key light and sky
  vec3 albedo = pow(diffuseColor, vec3(2.2));
  if (woven > 0.5) {
    vec2 w = max(fwidth(flatPlaceOut), vec2(1e-6));
    albedo *= 1.0 - 0.22 * lines(flatPlaceOut, 0.02, 0.0008, w);
    albedo *= 1.0 + 0.10 * weave(flatPlaceOut, 0.004, w);
  }
  // Light that surfaces send to each other in a fold has their colour.
  vec3 sky = vec3(open.y) / (1.0 - albedo * (1.0 - open.y));
  vec3 around = mix(GROUND, SKY, 0.5 + 0.5 * dot(n, upVC)) * sky;
  float cosine = dot(n, keyVC);
  vec3 light = albedo * (around + KEY * max(cosine, 0.0) * open.x + RIM * max(dot(n, rimVC), 0.0) * sky);
  // Fibres that stand off the cloth catch light where it is seen at a grazing angle.
  float grazing = pow(1.0 - clamp(dot(n, eye), 0.0, 1.0), 3.0);
  vec3 on_fibres = around + 0.4 * KEY * open.x * clamp(cosine + 0.4, 0.0, 1.0);
  light += sheen * grazing * mix(albedo, vec3(0.5), 0.3) * on_fibres;
  float ridge = gl_FrontFacing ? curvatureOut : -curvatureOut;
  light *= 1.0 + sheen * RELIEF * ridge / (RIDGE + abs(ridge));
  vec3 shown = pow(light / (1.0 + 0.6 * light), vec3(1.0 / 2.2));
  gl_FragData[0] = vec4(mix(shown, smoothstep(0.0, 1.0, shown), 0.5), 1.0);
"""


@lru_cache(maxsize=1)
def studio() -> Studio:
    """The one studio of the process."""
    return Studio()


@contextmanager
def _quiet_vtk() -> Iterator[None]:
    """VTK tries an X server first and complains on standard error before it takes EGL or Mesa."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)


class Studio:
    """One off-screen window with its floor and the meshes of the last picture."""

    def __init__(self) -> None:
        import pyvista

        with _quiet_vtk():
            self._plotter: Any = pyvista.Plotter(off_screen=True, lighting="none")
            below, above = BACKGROUND
            self._plotter.set_background(below, top=above)
            self._plotter.enable_anti_aliasing("msaa", multi_samples=8)
            self._plotter.add_light(pyvista.Light(light_type="headlight"))  # without one VTK hands on no normals
            self._add_floor()
            self._meshes: list[_Mesh] = []
            self._plotter.render()

    def draw(self, meshes: Sequence[Drawn], camera: Camera, size: tuple[int, int], floor: float | None) -> np.ndarray:
        """The picture, see :func:`runtime.draw.pictures.render`."""
        if tuple(self._plotter.window_size) != tuple(size):
            self._plotter.window_size = size  # not a new window: VTK does not free the old one
        # Seen from the target: float32 keeps its precision however far from the world's origin the scene is.
        origin = np.asarray(camera.target, dtype=np.float64)
        self._take(meshes)
        surfaces = [
            shown.surface(mesh, np.asarray(mesh.vertices, float) - origin)
            for mesh, shown in zip(meshes, self._meshes, strict=False)
        ]
        eye = np.asarray(camera.position, dtype=np.float64) - origin
        self._light(surfaces, eye, None if floor is None else floor - origin[1])
        view = self._plotter.camera
        view.position, view.focal_point, view.up = tuple(eye), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        view.view_angle = camera.field_of_view_deg
        self._plotter.renderer.ResetCameraClippingRange()
        self._plotter.render()
        return np.array(self._plotter.screenshot(return_img=True)[..., :3])

    def _take(self, meshes: Sequence[Drawn]) -> None:
        """Make a slot ready for each mesh; it is kept while faces and pattern stay the same."""
        for slot, mesh in enumerate(meshes):
            if slot == len(self._meshes):
                self._meshes.append(_Mesh(mesh))
            elif not self._meshes[slot].fits(mesh):
                self._plotter.renderer.RemoveActor(self._meshes[slot].actor)
                self._meshes[slot] = _Mesh(mesh)
            else:
                continue
            self._plotter.renderer.AddActor(self._meshes[slot].actor)
        for slot, shown in enumerate(self._meshes):
            shown.actor.SetVisibility(slot < len(meshes))

    def _light(self, surfaces: list[LitSurface], eye: np.ndarray, height: float | None) -> None:
        """Light the surfaces; the lights keep their places relative to the camera, so that every view is lit alike."""
        around = math.atan2(eye[0], eye[2])
        key = _direction(around + math.radians(KEY[0]), math.radians(KEY[1]))
        points = [surface.vertices for surface in surfaces]
        normals = [surface.normals for surface in surfaces]
        self._floor.SetVisibility(height is not None and len(surfaces) > 0)
        if not surfaces:
            return
        if height is not None:
            points.append(self._floor_points + np.array([0.0, height, 0.0], np.float32))
            normals.append(np.broadcast_to(np.array([0.0, 1.0, 0.0], np.float32), points[-1].shape))
        places, facing = np.concatenate(points), np.concatenate(normals)
        key_rays, sky_rays = directions_about(key, KEY_RADIUS_DEG, KEY_RAYS), directions_everywhere(SKY_RAYS)
        lit = exposure(surfaces, places, facing, key_rays, np.ones(KEY_RAYS))
        sky = exposure(surfaces, places, facing, sky_rays, 1.0 + 0.6 * sky_rays[:, 1])
        both = np.stack([lit[:, 0], sky[:, 0], lit[:, 1], sky[:, 1]], axis=1)
        parts = np.split(both, np.cumsum([len(part) for part in points])[:-1])
        back = eye / np.linalg.norm(eye)
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        view = np.stack([right, np.cross(back, right), back])
        rim = _direction(around + math.radians(RIM[0]), math.radians(RIM[1]))
        for shown, surface, part in zip(self._meshes, surfaces, parts, strict=False):
            shown.show(surface, part, {"keyVC": view @ key, "rimVC": view @ rim, "upVC": view[:, 1]})
        if height is not None:
            self._floor.position = (0.0, height, 0.0)
            self._shadow["rgba"][:, 3] = self._darkness(parts[-1])
            self._shadow.Modified()

    def _darkness(self, lit: np.ndarray) -> np.ndarray:
        """How opaque the floor's shadow is, 0 to 255; of the floor's light the key gives more than half."""
        square = lit[:, :2].reshape(FLOOR_CELLS, FLOOR_CELLS, 2)
        # Its few cells are larger than a body's faces: they would show the single directions of the sky.
        key, sky = (gaussian_filter(square[..., k], width) for k, width in ((0, 0.5), (1, 2.5)))
        dark = FLOOR_DARKNESS * self._floor_fade * (1.0 - 0.6 * key - 0.4 * sky).ravel()
        return np.round(255.0 * np.clip(dark, 0.0, 1.0)).astype(np.uint8)

    def _add_floor(self) -> None:
        """A square that only carries the shadow: black, as opaque as the shadow is dark."""
        import pyvista

        reach = FLOOR_REACH
        square = pyvista.PolyData.from_regular_faces(
            np.array([[-reach, 0, -reach], [-reach, 0, reach], [reach, 0, reach], [reach, 0, -reach]], np.float32),
            np.array([[0, 1, 2, 3]]),
        )
        square.active_texture_coordinates = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32)
        self._shadow: Any = pyvista.ImageData(dimensions=(FLOOR_CELLS, FLOOR_CELLS, 1))
        self._shadow["rgba"] = np.zeros((FLOOR_CELLS**2, 4), np.uint8)
        texture = pyvista.Texture(self._shadow)
        texture.interpolate = True
        self._floor = self._plotter.add_mesh(square, texture=texture, lighting=False, reset_camera=False)
        line = reach * (2.0 * (np.arange(FLOOR_CELLS) + 0.5) / FLOOR_CELLS - 1.0)
        z, x = np.meshgrid(line, line, indexing="ij")
        self._floor_points = np.stack([x, 0.0 * x, z], axis=-1).reshape(-1, 3).astype(np.float32)
        self._floor_fade = np.clip(3.0 * (1.0 - np.hypot(x, z) / reach), 0.0, 1.0).ravel()


class _Mesh:
    """One mesh of the window: its cuts, what VTK keeps of it, and the actor that shows it."""

    def __init__(self, mesh: Drawn) -> None:
        import pyvista
        from vtkmodules.vtkCommonDataModel import vtkDataObject
        from vtkmodules.vtkRenderingCore import vtkActor
        from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLPolyDataMapper

        self._faces, self._pattern = np.array(mesh.faces), None if mesh.pattern is None else np.array(mesh.pattern)
        self._cuts = _cuts(np.asarray(mesh.vertices, float), self._faces)
        self._count, faces = len(mesh.vertices), self._faces
        count = self._count
        flat = None if self._pattern is None else self._pattern.astype(np.float32)
        self._ends: list[np.ndarray] = []
        for _ in range(self._cuts):
            edges, side_edge = edges_of(faces)
            faces = cut_faces(faces, count + side_edge)
            flat = None if flat is None else cut_corners(flat)
            self._ends.append(edges)
            count += len(edges)
        self._fine, self._rings = faces, Rings(edges_of(faces)[0], count)
        # A vertex with several places in the pattern is shown once for each.
        self._of, shown, place = _parted(faces, flat, count)
        self._data: Any = pyvista.PolyData.from_regular_faces(np.zeros((len(self._of), 3), np.float32), shown)
        self._data.point_data["exposure"] = np.ones((len(self._of), 4), np.float32)
        self._data.point_data["curvature"] = np.zeros((len(self._of), 1), np.float32)
        self._data.point_data["flat"] = place
        mapper = vtkOpenGLPolyDataMapper()
        mapper.SetInputData(self._data)
        mapper.ScalarVisibilityOff()
        for name, array in (("exposure", "exposure"), ("curvature", "curvature"), ("flatPlace", "flat")):
            mapper.MapDataArrayToVertexAttribute(name, array, vtkDataObject.FIELD_ASSOCIATION_POINTS, -1)
        self.actor = vtkActor()
        self.actor.SetMapper(mapper)
        program = self.actor.GetShaderProperty()
        program.AddVertexShaderReplacement("//VTK::Normal::Dec", True, _VERTEX_DECLARATIONS, False)
        program.AddVertexShaderReplacement("//VTK::Normal::Impl", True, _VERTEX, False)
        program.AddFragmentShaderReplacement("//VTK::Normal::Dec", True, _FRAGMENT_DECLARATIONS, False)
        program.AddFragmentShaderReplacement("//VTK::Light::Impl", True, _FRAGMENT, False)
        self._uniforms = program.GetFragmentCustomUniforms()

    def fits(self, mesh: Drawn) -> bool:
        """Whether the mesh has these faces and this pattern, and about this size."""
        if self._pattern is None or mesh.pattern is None:
            same = self._pattern is mesh.pattern
        else:
            same = np.array_equal(self._pattern, mesh.pattern)
        same = same and self._count == len(mesh.vertices) and np.array_equal(self._faces, mesh.faces)
        return same and self._cuts == _cuts(np.asarray(mesh.vertices, float), self._faces)

    def surface(self, mesh: Drawn, vertices: np.ndarray) -> LitSurface:
        """The cut mesh at its place."""
        normals = vertex_normals(vertices, self._faces)
        for ends in self._ends:
            vertices = np.concatenate([vertices, vertices[ends].mean(axis=1)])
            middle = normals[ends].sum(axis=1)
            length = np.linalg.norm(middle, axis=1, keepdims=True)
            normals = np.concatenate([normals, middle / np.maximum(length, 1e-12)])
        self._uniforms.SetUniformf("woven", float(mesh.pattern is not None))
        self._uniforms.SetUniformf("sheen", float(mesh.cloth))
        self.actor.GetProperty().SetColor(*mesh.color)
        return LitSurface(vertices.astype(np.float32), self._fine, normals.astype(np.float32))

    def show(self, surface: LitSurface, lit: np.ndarray, directions: dict[str, np.ndarray]) -> None:
        """Hand places, normals, exposure and the lights' directions to VTK."""
        self._data.points = surface.vertices[self._of]
        self._data.point_data.active_normals = surface.normals[self._of]
        self._data.point_data["exposure"] = self._rings.smoothed(lit, SOFTENING)[self._of]
        self._data.point_data["curvature"] = self._rings.curvature(surface.vertices, surface.normals)[self._of]
        for name, direction in directions.items():
            self._uniforms.SetUniform3f(name, [float(part) for part in direction])


def _cuts(vertices: np.ndarray, faces: np.ndarray) -> int:
    """How often each face is cut in four, so that the median edge is no longer than FINE_EDGE."""
    if not len(faces):
        return 0
    sides = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    return int(np.clip(np.ceil(np.log2(max(float(np.median(sides)), 1e-9) / FINE_EDGE)), 0, MAX_CUTS))


def _parted(faces: np.ndarray, flat: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices with one place in the pattern each: the vertex of each, the faces of them, and the places."""
    if flat is None:
        return np.arange(count), faces, np.zeros((count, 2), np.float32)
    keys = np.column_stack([faces.ravel(), np.round(flat.reshape(-1, 2) / 1e-5).astype(np.int64)])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return faces.ravel()[first], inverse.reshape(-1, 3), flat.reshape(-1, 2)[first]


def _direction(azimuth: float, elevation: float) -> np.ndarray:
    return np.array(
        [math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation)]
    )

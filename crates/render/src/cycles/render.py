"""Renders one exported job with Blender's Cycles: `python render.py FOLDER`.

FOLDER holds scene.json, mesh.bin and images, as `export` in mod.rs writes them. An EXR file (linear Rec. 709,
premultiplied RGBA) is written per view and light, vVVV_lLLL.exr, one of the base colour per view, vVVV_albedo.exr,
and seconds.json with the time of each of the former.
"""

import json
import math
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

FOLDER = Path(sys.argv[-1])
SCENE = json.loads((FOLDER / "scene.json").read_text())


def image(name):
    """An image whose numbers are taken as they are."""
    loaded = bpy.data.images.load(str(FOLDER / name))
    loaded.colorspace_settings.name = "Linear Rec.709"
    loaded.alpha_mode = "CHANNEL_PACKED"
    return loaded


def texture(nodes, name):
    node = nodes.new("ShaderNodeTexImage")
    node.image = image(name)
    node.extension = "EXTEND"
    return node


def material():
    made = bpy.data.materials.new("baked")
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    principled = nodes["Principled BSDF"]
    base, properties, relief = (texture(nodes, f"{n}.exr") for n in ("base", "properties", "relief"))
    split = nodes.new("ShaderNodeSeparateColor")
    links.new(properties.outputs["Color"], split.inputs["Color"])
    links.new(base.outputs["Color"], principled.inputs["Base Color"])
    links.new(split.outputs["Red"], principled.inputs["Roughness"])
    links.new(split.outputs["Green"], principled.inputs["Metallic"])
    links.new(split.outputs["Blue"], principled.inputs["Specular IOR Level"])
    links.new(properties.outputs["Alpha"], principled.inputs["Coat Weight"])
    links.new(relief.outputs["Alpha"], principled.inputs["Coat Roughness"])
    if SCENE["has_tint"]:
        links.new(texture(nodes, "tint.exr").outputs["Color"], principled.inputs["Specular Tint"])
    if SCENE["see_through"]:
        links.new(base.outputs["Alpha"], principled.inputs["Alpha"])
    if SCENE["has_relief"]:
        normal = nodes.new("ShaderNodeNormalMap")
        normal.space = "OBJECT"
        links.new(relief.outputs["Color"], normal.inputs["Color"])
        links.new(normal.outputs["Normal"], principled.inputs["Normal"])
        links.new(normal.outputs["Normal"], principled.inputs["Coat Normal"])
    return made


def show_base_color(made):
    """Lets surfaces glow in their base colour and reflect nothing."""
    nodes, links = made.node_tree.nodes, made.node_tree.links
    principled = nodes["Principled BSDF"]
    base = principled.inputs["Base Color"].links[0].from_node
    emission = nodes.new("ShaderNodeEmission")
    links.new(base.outputs["Color"], emission.inputs["Color"])
    shown = emission.outputs["Emission"]
    if SCENE["see_through"]:
        mix, nothing = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfTransparent")
        links.new(base.outputs["Alpha"], mix.inputs["Fac"])
        links.new(nothing.outputs["BSDF"], mix.inputs[1])
        links.new(shown, mix.inputs[2])
        shown = mix.outputs["Shader"]
    links.new(shown, nodes["Material Output"].inputs["Surface"])


def mesh():
    n = SCENE["triangles"]
    data = np.fromfile(FOLDER / "mesh.bin", dtype="<f4")
    positions, normals, uvs = np.split(data, [9 * n, 18 * n])
    made = bpy.data.meshes.new("object")
    made.from_pydata(positions.reshape(-1, 3).tolist(), [], np.arange(3 * n).reshape(-1, 3).tolist())
    made.uv_layers.new(name="atlas").data.foreach_set("uv", uvs)
    made.shade_smooth()
    made.normals_split_custom_set(normals.reshape(-1, 3).tolist())
    made.materials.append(material())
    made.update()
    bpy.context.collection.objects.link(bpy.data.objects.new("object", made))


def settings():
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    if SCENE["threads"]:
        scene.render.threads_mode = "FIXED"
        scene.render.threads = SCENE["threads"]
    scene.render.film_transparent = True
    scene.render.use_persistent_data = True
    scene.render.resolution_percentage = 100
    output = scene.render.image_settings
    output.file_format, output.color_mode, output.color_depth = "OPEN_EXR", "RGBA", "32"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = SCENE["samples"]
    cycles.seed = SCENE["seed"]
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = SCENE["denoise"]
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    # Nothing that trades energy for less noise.
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.light_sampling_threshold = 0.0
    for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
        setattr(cycles, f"{kind}_bounces", SCENE["max_bounces"])
    cycles.transparent_max_bounces = 64
    return scene


def world():
    """Black until an environment is shown; returns what switches it."""
    made = bpy.data.worlds.new("world")
    made.use_nodes = True
    bpy.context.scene.world = made
    nodes, links = made.node_tree.nodes, made.node_tree.links
    background = nodes["Background"]
    background.inputs["Strength"].default_value = 0.0
    coordinates = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")
    environment = nodes.new("ShaderNodeTexEnvironment")
    tint = nodes.new("ShaderNodeMix")
    tint.data_type, tint.blend_type = "RGBA", "MULTIPLY"
    tint.inputs["Factor"].default_value = 1.0
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], environment.inputs["Vector"])
    links.new(environment.outputs["Color"], tint.inputs[6])
    links.new(tint.outputs[2], background.inputs["Color"])

    def show(light):
        background.inputs["Strength"].default_value = 0.0 if light is None else 1.0
        if light is not None:
            environment.image = image(light["file"])
            tint.inputs[7].default_value = (*light["strength"], 1.0)
            # From the world to the map.
            turn = Matrix(light["rotation"]).transposed()
            mapping.inputs["Rotation"].default_value = turn.to_euler("XYZ")

    return show


def aimed(direction, side=None):
    """A pose whose -z looks along `direction`, which is how Blender's lamps shine."""
    z = -Vector(direction)
    x = Vector(side) if side else z.orthogonal().normalized()
    return Matrix((x, z.cross(x), z)).transposed().to_4x4()


def lamp(light):
    kind = light["type"].upper()
    data = bpy.data.lights.new("lamp", kind)
    data.energy = light["strength" if kind == "SUN" else "power"]
    data.color = light["color"]
    data.cycles.max_bounces = SCENE["max_bounces"]
    pose = aimed(light["direction"], light.get("side")) if "direction" in light else Matrix()
    pose.translation = light.get("position", (0.0, 0.0, 0.0))
    if kind in ("POINT", "SPOT"):
        data.shadow_soft_size = light["radius"]
    if kind == "SPOT":
        data.spot_size, data.spot_blend = light["angle"], light["blend"]
    elif kind == "AREA":
        data.shape, data.size = "SQUARE", light["size"]
    elif kind == "SUN":
        data.angle = light["angle"]
    made = bpy.data.objects.new("lamp", data)
    made.matrix_world = pose
    made.visible_camera = False
    bpy.context.collection.objects.link(made)
    return made


def look(camera, view):
    """Places the camera; ours looks along +z with y down, Blender's along −z with y up."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = view["width"], view["height"]
    scene.render.pixel_aspect_y = view["fx"] / view["fy"]
    data = camera.data
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = 36.0 * view["fx"] / view["width"]
    data.shift_x = 0.5 - view["cx"] / view["width"]
    data.shift_y = (view["cy"] - 0.5 * view["height"]) / view["width"]
    data.clip_start = 1e-3
    camera.matrix_world = Matrix(view["camera_to_world"]) @ Matrix.Diagonal((1, -1, -1, 1))


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = settings()
    mesh()
    show = world()
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.collection.objects.link(camera)
    scene.camera = camera
    seconds = []
    for l, light in enumerate(SCENE["lights"]):
        lit = None
        if light["type"] == "environment":
            show(light)
        else:
            show(None)
            lit = lamp(light)
        for v, view in enumerate(SCENE["cameras"]):
            look(camera, view)
            scene.render.filepath = str(FOLDER / f"v{v:03}_l{l:03}.exr")
            start = time.perf_counter()
            bpy.ops.render.render(write_still=True)
            seconds.append(time.perf_counter() - start)
        if lit is not None:
            bpy.data.objects.remove(lit)
    show(None)
    show_base_color(bpy.data.materials["baked"])
    scene.cycles.use_denoising = False
    for v, view in enumerate(SCENE["cameras"]):
        look(camera, view)
        scene.render.filepath = str(FOLDER / f"v{v:03}_albedo.exr")
        bpy.ops.render.render(write_still=True)
    (FOLDER / "seconds.json").write_text(json.dumps(seconds))


main()

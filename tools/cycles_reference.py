"""Renders an object of `data/cycles` again with Blender's Cycles, without the denoiser, as a folder of the same layout.

    python tools/cycles_reference.py ../shared/data/cycles/cat OUT [--every 4] [--samples 256] [--denoise]
    cargo run --release -p lumi-render --example reference -- OUT --step 1

needs Blender's module (python3.11 -m pip install "bpy==4.5.*"). Nothing that changes energy is on: no clamping, no
filtering of glossy light, no threshold for lights; pixels are boxes, as our renderer's are. It shows how much of a
difference to the set's own images is theirs: they were denoised, which takes sharp highlights for noise.
"""

import argparse
import json
import os
from pathlib import Path

import bpy
from mathutils import Matrix, Vector


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("object", type=Path, help="folder with cameras.json, lights.json and object.json")
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=4, help="render every so many views")
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--denoise", action="store_true", help="as the set's images were")
    return parser.parse_args()


def settings(args, size):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.render.use_persistent_data = True
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    output = scene.render.image_settings
    output.file_format, output.color_mode, output.color_depth = "OPEN_EXR", "RGBA", "16"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = args.samples, False, args.denoise
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    for kind in ("max", "diffuse", "glossy"):
        setattr(cycles, f"{kind}_bounces", 12)
    return scene


def model(args, described):
    bpy.ops.import_scene.gltf(filepath=str(args.object / described["model"]))
    place = Matrix(described["model_to_world"])
    for top in [o for o in bpy.data.objects if o.parent is None]:
        top.matrix_world = place @ top.matrix_world
    # Two objects had another roughness than their files.
    for made in bpy.data.materials:
        for node in made.node_tree.nodes if "roughness" in described and made.use_nodes else []:
            if node.type == "BSDF_PRINCIPLED":
                for link in list(node.inputs["Roughness"].links):
                    made.node_tree.links.remove(link)
                node.inputs["Roughness"].default_value = described["roughness"]


def world(scene):
    """A map that `show(light)` turns and lights up, or `show(None)` turns off."""
    made = bpy.data.worlds.new("world")
    made.use_nodes = True
    scene.world = made
    nodes, links = made.node_tree.nodes, made.node_tree.links
    coordinates, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    environment, background = nodes.new("ShaderNodeTexEnvironment"), nodes["Background"]
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], environment.inputs["Vector"])
    links.new(environment.outputs["Color"], background.inputs["Color"])

    def show(folder, light):
        background.inputs["Strength"].default_value = light["strength"] if light else 0.0
        if light:
            environment.image = bpy.data.images.load(str(folder / light["file"]))
            environment.image.colorspace_settings.name = "Linear Rec.709"
            mapping.inputs["Rotation"].default_value = (0.0, 0.0, -light["rotation_z"])

    return show


def lamp(scene, light):
    data = bpy.data.lights.new("lamp", light["type"].upper())
    data.energy, data.color = light["power_watts"], light["color"]
    if light["type"] == "point":
        data.shadow_soft_size = light["radius"]
        pose = Matrix.Translation(light["position"])
    else:
        data.shape, data.size = "SQUARE", light["size"]
        x, z = Vector(light["side_u"]), -Vector(light["direction"])
        pose = Matrix((x, z.cross(x), z)).transposed().to_4x4()
        pose.translation = light["position"]
    made = bpy.data.objects.new("lamp", data)
    made.matrix_world, made.visible_camera = pose, False
    scene.collection.objects.link(made)
    return made


def main():
    args = arguments()
    described, cameras, lights = (
        json.loads((args.object / f"{name}.json").read_text()) for name in ("object", "cameras", "lights")
    )
    cameras["views"] = cameras["views"][:: args.every]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = settings(args, cameras["views"][0]["width"])
    model(args, described)
    show = world(scene)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.clip_start = 1e-3
    args.out.mkdir(parents=True, exist_ok=True)
    for light in lights:
        here = light["type"] == "env"
        show(args.object, light if here else None)
        lit = None if here else lamp(scene, light)
        for view in cameras["views"]:
            camera.data.sensor_width, camera.data.lens = 36.0, 36.0 * view["fx"] / view["width"]
            camera.matrix_world = Matrix(view["camera_to_world"]) @ Matrix.Diagonal((1, -1, -1, 1))
            scene.render.filepath = str(args.out / f"{view['name']}_{light['name']}.exr")
            bpy.ops.render.render(write_still=True)
        if lit:
            bpy.data.objects.remove(lit)
    # Paths to files that stay where they are.
    described["model"] = os.path.relpath(args.object / described["model"], args.out)
    for light in lights:
        if "file" in light:
            light["file"] = os.path.relpath(args.object / light["file"], args.out)
    for name, value in (("object", described), ("cameras", cameras), ("lights", lights)):
        (args.out / f"{name}.json").write_text(json.dumps(value, indent=1))


main()

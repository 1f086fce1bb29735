//! The rendered objects and the photographed captures load and hold what their notes say.
#![allow(clippy::unwrap_used)]

use glam::Vec3;
use lumi_core::{Light, Role};
use lumi_data::manifest::ObjectCases;
use lumi_data::{Lighting, Manifest, inputs_under, open, photographs, views_under};
use lumi_testkit::{demo, extra};

#[test]
fn every_manifest_object_loads_and_its_cases_resolve() {
    let mut collections = vec![(demo(), 1)];
    collections.extend(extra("data/cycles").map(|folder| (folder, 8)));
    for (folder, objects) in collections {
        let manifest = Manifest::read(&folder).unwrap();
        assert_eq!(
            (manifest.objects.len(), manifest.resolution),
            (objects, 128)
        );
        resolves(&manifest);
    }
}

fn resolves(manifest: &Manifest) {
    for (name, cases) in &manifest.objects {
        let scene = manifest.open(name).unwrap();
        assert_eq!(&scene.name, name);
        assert_eq!(scene.with_role(Role::Input).len(), 8);
        let basis = scene.basis.as_ref().unwrap();
        let kinds: Vec<_> = basis.lights.iter().map(|l| l.light.kind()).collect();
        assert_eq!(kinds.iter().filter(|k| **k == "point").count(), 4);
        assert_eq!(
            ObjectCases::indices(&scene, &cases.views).unwrap(),
            scene.with_role(Role::Target)
        );
        for lighting in cases.targets.values() {
            assert_eq!(lighting.resolve(basis).unwrap().len(), lighting.0.len());
        }
        let sums = ObjectCases::sums(&cases.additive[0]);
        assert_eq!(sums.last().unwrap().0.len(), cases.additive[0].len());
        // The unit ball of object.json is model space already.
        assert!(scene.to_model.point(Vec3::X).distance(Vec3::X) < 1e-6);
    }
}

#[test]
fn views_under_a_lighting_follow_the_stated_formula() {
    let scene = open(demo().join("spot")).unwrap();
    let lighting = Lighting::from([("env0", 0.7), ("point1", 0.4)]);
    let views = inputs_under(&scene, &lighting, 64).unwrap();
    assert_eq!(views.len(), 8);
    let basis = scene.basis.as_ref().unwrap();
    let lights = [basis.find("env0").unwrap(), basis.find("point1").unwrap()];
    let (x, y) = (33, 30);
    // Box average of premultiplied values, then the manifest's formula on straight ones.
    let mut alpha = 0.0;
    let mut red = 0.0;
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let at = (2 * y + dy) * 128 + 2 * x + dx;
        alpha += 0.25 * basis.radiance[lights[0]][0].pixels[at][3];
        red += 0.25
            * (0.7 * basis.radiance[lights[0]][0].pixels[at][0]
                + 0.4 * basis.radiance[lights[1]][0].pixels[at][0]);
    }
    let expected = lumi_core::color::srgb_encode(red / alpha) * alpha + 1.0 - alpha;
    let image = views[0].image.as_ref().unwrap();
    assert!(alpha > 0.5, "the pixel shows the object");
    assert!((image.pixels[y * 64 + x][0] - expected).abs() < 1e-5);
    assert_eq!((views[0].camera.width, views[0].camera.cx), (64, 32.0));
    assert_eq!(image.pixels[0], [1.0; 3], "white behind the object");

    let scaled = lighting.lights(&scene).unwrap();
    let Light::Point(point) = scaled[1] else {
        panic!("point1 comes second")
    };
    assert!((point.color[0] - 0.4).abs() < 1e-6);
    let unknown = views_under(&scene, &[0], &Lighting::single("sun"), 64)
        .unwrap_err()
        .to_string();
    assert!(
        unknown.contains("`sun`") && unknown.contains("env0"),
        "{unknown}"
    );
}

#[test]
fn the_objects_project_inside_their_masks() {
    // Poses, masks and files agree only if conventions do: the origin is inside every silhouette.
    let scene = open(demo().join("spot")).unwrap();
    let basis = scene.basis.as_ref().unwrap();
    for (i, view) in scene.views.iter().enumerate() {
        let (x, y, z) = view.camera.project(Vec3::ZERO);
        let at = y as usize * 128 + x as usize;
        assert!(
            z > 0.0 && basis.radiance[0][i].pixels[at][3] > 0.9,
            "{}",
            view.name
        );
    }
}

#[test]
fn the_captures_load() {
    for (name, count, size) in [
        ("ethiopian_head", 20, (512, 512)),
        ("goldcape", 16, (512, 512)),
        ("mother_child", 19, (512, 384)),
    ] {
        let Some(folder) = extra(&format!("data/captures/{name}")) else {
            continue;
        };
        let scene = open(folder).unwrap();
        assert_eq!((scene.name.as_str(), scene.views.len()), (name, count));
        assert_eq!(scene.with_role(Role::Target).len(), count / 8);
        for view in &scene.views {
            let image = view.image.as_ref().unwrap();
            assert_eq!((image.width, image.height), size);
            let alpha = image.alpha.as_ref().unwrap();
            // In model space the camera stands outside the unit ball and sees it.
            let camera = view.camera.transformed(&scene.to_model);
            assert!(
                camera.centre().length() > 1.0,
                "{name} {}: {}",
                view.name,
                camera.centre().length()
            );
            let (x, y, z) = camera.project(Vec3::ZERO);
            assert!(z > 0.0 && x > 0.0 && y > 0.0 && x < size.0 as f32 && y < size.1 as f32);
            assert!(alpha.iter().any(|a| *a > 0.5));
        }
        let shown = photographs(&scene, &[0, 1], 96).unwrap();
        let camera = &shown[0].camera;
        assert_eq!(
            (
                camera.width,
                camera.height,
                shown[0].image.as_ref().unwrap().pixels.len()
            ),
            (96, 96, 96 * 96)
        );
        assert!((camera.cy - 48.0).abs() < 1e-3 && (camera.fx - camera.fy).abs() < 1e-3);
        assert!((camera.fx - scene.views[0].camera.fx * 96.0 / size.1 as f32).abs() < 1e-2);
        // The square keeps the scene's centre in view, and pixels follow their camera.
        let centre = scene.to_model.inverse().point(Vec3::ZERO);
        let (x, y, _) = camera.project(centre);
        assert!(
            x > 10.0 && x < 86.0 && y > 0.0 && y < 96.0,
            "{name}: {x} {y}"
        );
    }
}

//! Agreement with Blender Cycles, per part and light. Few paths, so that it is quick: the noise of a mean
//! over hundreds of pixels stays well below the tolerances. `examples/reference.rs` prints the whole table.

#![allow(clippy::unwrap_used)]

mod support;

use lumi_testkit::{extra, shared};

/// Mean radiance over each part must agree within this.
const TOLERANCE: f64 = 0.03;

#[test]
fn spheres_and_a_cube_under_each_light() {
    for full in [false, true] {
        let case = support::spheres(&shared("data/compare"), full).unwrap();
        let (rows, images) = support::compare(&case, 16);
        assert_eq!((rows.len(), images.len()), (9, 3));
        for r in rows {
            let name = format!("{}: {} under {}", case.name, r.part, r.light);
            assert!(r.mean.abs() < TOLERANCE, "{name}: mean {:+.3}", r.mean);
            assert!(r.absolute < 0.2, "{name}: apart {:.3}", r.absolute);
        }
    }
}

#[test]
fn models_with_images_under_each_light() {
    for name in ["cyborg_female", "suzanne", "flight_helmet", "water_bottle"] {
        // Only `spot` among these may be shipped, and its mesh is with them.
        let Some(folder) = extra(&format!("data/cycles/{name}")) else {
            continue;
        };
        let case = support::object(&folder, 4);
        let (rows, _) = support::compare(&case, 16);
        assert_eq!(rows.len(), 8);
        for r in rows {
            let name = format!("{name} under {}", r.light);
            assert!(r.mean.abs() < TOLERANCE, "{name}: mean {:+.3}", r.mean);
        }
    }
}

//! The authors' network, tensor by tensor, against the golden cases.
#![allow(clippy::unwrap_used)]

use burn::tensor::Device;
use lumi_kernels::Precision;
use lumi_model::{import, verify};
use lumi_testkit::shared;

fn check(variant: &str, weights: &str) {
    let folder = shared("reference/golden").join(variant);
    let config = import::read_config(&folder.join("config.json")).unwrap();
    let device = Device::flex();
    let network = import::load_authors(&folder.join(weights), &config, &device).unwrap();
    let rows =
        verify::verify(&network, &config, &folder.join("case.safetensors"), &device).unwrap();
    for row in &rows {
        println!(
            "{variant} {:32} {:.2e} (≤ {:.0e})",
            row.tensor, row.max_error, row.tolerance
        );
    }
    assert!(rows.len() > 25, "only {} tensors compared", rows.len());
    let bad: Vec<_> = rows.iter().filter(|r| !r.ok()).collect();
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn mlp_matches() {
    check("mlp", "weights.safetensors");
}

#[test]
fn dpt_matches() {
    check("dpt", "weights.safetensors");
}

#[test]
fn checkpoints_match() {
    check("mlp", "checkpoint.pt");
    check("dpt", "checkpoint.pt");
}

/// With bf16 operands pictures stay as near as the authors' own mixed precision does (SPEC §2).
#[test]
fn bf16_pictures_stay_near() {
    for variant in ["mlp", "dpt"] {
        let folder = shared("reference/golden").join(variant);
        let config = import::read_config(&folder.join("config.json")).unwrap();
        let device = Device::flex();
        let network =
            import::load_authors(&folder.join("weights.safetensors"), &config, &device).unwrap();
        let network = network.with_precision(Precision::Bf16);
        let case = folder.join("case.safetensors");
        let rows = verify::verify(&network, &config, &case, &device).unwrap();
        let renders: Vec<_> = rows
            .iter()
            .filter(|r| r.tensor.starts_with("render."))
            .collect();
        assert!(
            renders.len() >= 5,
            "only {} pictures compared",
            renders.len()
        );
        for row in renders {
            println!(
                "{variant} {:20} mean {:.1e}, max {:.1e}",
                row.tensor, row.mean_error, row.max_error
            );
            assert!(row.mean_error < 2e-3 && row.max_error < 0.02, "{row:?}");
        }
    }
}

/// Rays of our cameras against the golden ones: through `batch`, as everything else takes them.
#[test]
fn rays_match() {
    use lumi_core::Camera;
    use lumi_core::glam::Mat4;
    use lumi_model::batch::ray_channels;
    use lumi_model::config::RayFeatures;
    for variant in ["mlp", "dpt"] {
        let case = lumi_testkit::golden(&format!("reference/golden/{variant}/case.safetensors"));
        let base = case["target_ray_d"].shape[3];
        // Name of the directions, of the poses and of the intrinsics. `resize` keeps the intrinsics of the
        // base size, which is the authors' quirk.
        for (rays, poses, intrinsics) in [
            ("ray_d", "c2w", "fxfycxcy"),
            ("target_ray_d", "target_c2w", "target_fxfycxcy"),
            ("resize.ray_d", "target_c2w", "target_fxfycxcy"),
            ("nonsquare.ray_d", "target_c2w", "nonsquare.fxfycxcy"),
        ] {
            let shape = &case[rays].shape;
            let (height, width) = (shape[3], shape[4]);
            let views = shape[0] * shape[1];
            let poses = case[poses].rows::<16>();
            let k = case[intrinsics].rows::<4>();
            assert!(base > 0 && views <= poses.len());
            for (view, directions) in case[rays].data.chunks(3 * height * width).enumerate() {
                let [fx, fy, cx, cy] = k[view];
                let camera_to_world = Mat4::from_cols_array(&poses[view]).transpose();
                let camera = Camera {
                    width,
                    height,
                    fx,
                    fy,
                    cx,
                    cy,
                    camera_to_world,
                };
                let ours = ray_channels(&camera, RayFeatures::Plucker);
                let worst = ours[3 * height * width..]
                    .iter()
                    .zip(directions)
                    .fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
                assert!(worst < 5e-6, "{variant} {rays} view {view}: {worst}");
            }
        }
    }
}

//! What a capture looks like on one page: where its cameras stand, and each view with its mask.

use super::{Report, ViewReport};
use crate::ball::MASK_THRESHOLD;
use crate::page::{BLUE, Color, FAINT, GREEN, INK, ORANGE, Page, RED, YELLOW};
use crate::views::square;
use glam::{Vec2, Vec3};
use lumi_core::{Camera, DisplayImage, Result, Role, Scene};

const GAP: usize = 14;
const LINE: usize = 20;
/// Side of a diagram.
const DIAGRAM: usize = 330;
/// Longer side of a view.
const TILE: usize = 158;
/// Views in a row.
const COLUMNS: usize = 6;
/// Most views that are shown.
const SHOWN: usize = 48;
/// Most problems that are listed.
const LISTED: usize = 12;

/// Draws the page of a scene and its report: cameras from above and from the side in model space (inputs blue,
/// held-out views orange, lights yellow, the bounding ball as a circle), the problems, and the views with
/// their masks outlined, green where poses and masks agree. A thin square is the part that models see.
///
/// # Errors
/// If the built-in font cannot be read.
pub fn picture(scene: &Scene, report: &Report) -> Result<DisplayImage> {
    let summary = report.to_string();
    let lines: Vec<&str> = summary.lines().skip(1).collect();
    let facts = lines.len() - report.problems.len().max(1);
    let shown = scene.views.len().min(SHOWN);
    let left = DIAGRAM + 3 * GAP;
    let width = left + COLUMNS * (TILE + GAP) + GAP;
    let listed = report.problems.len().clamp(1, LISTED + 1);
    let words = facts + listed + 1;
    let top = 56 + words * LINE + GAP;
    let rows = shown.div_ceil(COLUMNS);
    let height = (top + rows * (TILE + LINE + GAP)).max(top + 2 * (DIAGRAM + LINE + GAP)) + GAP;
    let mut page = Page::new(width, height)?;

    let title = format!("{} ({})", report.name, report.format);
    page.text(&title, at(2 * GAP, GAP), 28.0, INK);
    let room = (width - 4 * GAP) as f32;
    for (i, line) in lines[..facts].iter().enumerate() {
        let line = page.fitted(line.trim(), 16.0, room);
        page.text(&line, at(2 * GAP, 56 + i * LINE), 16.0, FAINT);
    }
    for (i, (line, color)) in problems(report).into_iter().enumerate() {
        let line = page.fitted(&line, 16.0, room);
        page.text(
            &line,
            at(2 * GAP, 56 + (facts + i) * LINE + LINE / 2),
            16.0,
            color,
        );
    }

    diagram(&mut page, scene, (2 * GAP, top), "from above", |p| {
        Vec2::new(p.x, -p.y)
    });
    let below = top + DIAGRAM + LINE + GAP;
    diagram(
        &mut page,
        scene,
        (2 * GAP, below),
        "from the side, up is up",
        |p| Vec2::new(p.x, -p.z),
    );
    for i in 0..shown {
        let corner = (
            left + i % COLUMNS * (TILE + GAP),
            top + i / COLUMNS * (TILE + LINE + GAP),
        );
        view(&mut page, scene, i, &report.views[i], corner);
    }
    if shown < scene.views.len() {
        let line = format!("{} more views are not shown", scene.views.len() - shown);
        page.text(&line, at(left, height - GAP - LINE / 2), 13.0, FAINT);
    }
    Ok(page.finish())
}

fn at(x: usize, y: usize) -> Vec2 {
    Vec2::new(x as f32, y as f32)
}

fn problems(report: &Report) -> Vec<(String, Color)> {
    if report.problems.is_empty() {
        return vec![("no problems".to_owned(), GREEN)];
    }
    let line = |p: &super::Problem| {
        let color = if p.severity == super::Severity::Error {
            RED
        } else {
            ORANGE
        };
        (format!("{}: {}: {}", p.severity, p.field, p.text), color)
    };
    let mut lines: Vec<_> = report.problems.iter().take(LISTED).map(line).collect();
    if report.problems.len() > LISTED {
        lines.push((
            format!("… and {} more", report.problems.len() - LISTED),
            ORANGE,
        ));
    }
    lines
}

/// Cameras, ball and lights of model space on a plane.
fn diagram(
    page: &mut Page,
    scene: &Scene,
    (x, y): (usize, usize),
    caption: &str,
    flat: fn(Vec3) -> Vec2,
) {
    let cameras: Vec<Camera> = scene
        .views
        .iter()
        .map(|v| v.camera.transformed(&scene.to_model))
        .collect();
    let lights = local_lights(scene);
    let reach = cameras
        .iter()
        .map(|c| c.centre().length())
        .fold(1.0, f32::max);
    let reach = lights
        .iter()
        .map(|p| p.length())
        .filter(|d| *d < 3.0 * reach)
        .fold(reach, f32::max);
    let middle = at(x, y) + 0.5 * DIAGRAM as f32;
    let scale = 0.46 * DIAGRAM as f32 / reach;
    let place = |p: Vec3| middle + scale * flat(p);
    page.frame(at(x, y), at(x + DIAGRAM, y + DIAGRAM), 1.0, [0.8, 0.8, 0.8]);
    page.circle(middle, scale, 1.5, FAINT);
    for (axis, name) in [(Vec3::X, "x"), (Vec3::Y, "y"), (Vec3::Z, "z")] {
        if flat(axis).length() > 0.5 {
            page.line(middle, place(0.6 * axis), 1.0, FAINT);
            page.text(name, place(0.72 * axis) - Vec2::new(3.0, 8.0), 13.0, FAINT);
        }
    }
    for p in lights {
        page.disc(place(p), 5.0, YELLOW);
    }
    // Inputs come last, so that they are on top.
    for role in [Role::Target, Role::Input] {
        for (camera, view) in cameras.iter().zip(&scene.views) {
            if view.role != role {
                continue;
            }
            let (color, c) = (role_color(role), camera);
            let edge = |px: f32, py: f32| c.centre() + 0.13 * reach * c.direction(px, py);
            let (w, h) = (c.width as f32, c.height as f32);
            // The widest pair of opposite edges of the frustum, as this plane shows it.
            let pairs = [
                [edge(0.0, 0.5 * h), edge(w, 0.5 * h)],
                [edge(0.5 * w, 0.0), edge(0.5 * w, h)],
            ];
            let span = |p: &[Vec3; 2]| flat(p[0]).distance(flat(p[1]));
            let [a, b] = if span(&pairs[0]) >= span(&pairs[1]) {
                pairs[0]
            } else {
                pairs[1]
            };
            for end in [a, b] {
                page.line(place(c.centre()), place(end), 1.2, color);
            }
            page.line(place(a), place(b), 1.2, color);
            page.disc(place(c.centre()), 3.0, color);
        }
    }
    page.text(caption, at(x, y + DIAGRAM + 2), 14.0, FAINT);
}

fn role_color(role: Role) -> Color {
    match role {
        Role::Input => BLUE,
        Role::Target => ORANGE,
    }
}

/// Where the basis's lamps stand in model space.
fn local_lights(scene: &Scene) -> Vec<Vec3> {
    let lights = scene.basis.iter().flat_map(|b| &b.lights);
    let all = lights.chain(scene.lit_by.first().into_iter().flatten());
    all.filter_map(|named| named.light.position())
        .map(|position| scene.to_model.point(position))
        .collect()
}

/// A view with its mask's outline and the square that models see.
fn view(page: &mut Page, scene: &Scene, i: usize, report: &ViewReport, (x, y): (usize, usize)) {
    let full = shown(scene, i);
    let longer = full.width.max(full.height);
    let side = |s: usize| (s * TILE).div_ceil(longer);
    let mut small = full.resized(side(full.width), side(full.height));
    let good = report.hull.is_none_or(|iou| iou >= 0.75);
    outline(&mut small, if good { GREEN } else { RED });
    let corner = (x + (TILE - small.width) / 2, y + (TILE - small.height) / 2);
    page.paste(&small, corner);
    let (first, size) = square(scene, &scene.views[i].camera, 0);
    if size.0 < longer {
        let scale = TILE as f32 / longer as f32;
        let low = at(corner.0, corner.1) + scale * at(first.0, first.1);
        page.frame(low, low + scale * at(size.0, size.1), 1.0, FAINT);
    }
    let mut caption = report.name.clone();
    if let Some(iou) = report.hull {
        caption += &format!("  IoU {iou:.2}");
    }
    let caption = page.fitted(&caption, 13.0, TILE as f32 - 10.0);
    let color = role_color(scene.views[i].role);
    page.disc(at(x + 4, y + TILE + 10), 3.5, color);
    page.text(&caption, at(x + 12, y + TILE + 3), 13.0, FAINT);
}

/// A view's photograph, or all lights of the basis at once, as bright as suits a page.
fn shown(scene: &Scene, i: usize) -> DisplayImage {
    if let Some(image) = &scene.views[i].image {
        return image.clone();
    }
    let camera = &scene.views[i].camera;
    match &scene.basis {
        Some(basis) if !basis.lights.is_empty() => {
            let all: Vec<_> = (0..basis.lights.len()).map(|l| (l, [1.0; 3])).collect();
            let mut image = basis.compose(i, &all);
            let (mut sum, mut covered) = (0.0, 0.0);
            for p in &image.pixels {
                sum += (p[0] + p[1] + p[2]) / 3.0;
                covered += p[3];
            }
            let gain = if sum > 0.0 { 0.3 * covered / sum } else { 1.0 };
            for p in &mut image.pixels {
                p[..3].iter_mut().for_each(|v| *v *= gain);
            }
            image.to_display()
        }
        _ => DisplayImage::filled(camera.width, camera.height, [0.9; 3]),
    }
}

/// Draws the mask's edge.
fn outline(image: &mut DisplayImage, color: Color) {
    let Some(alpha) = image.alpha.take() else {
        return;
    };
    let (width, height) = (image.width, image.height);
    let inside = |x: usize, y: usize| alpha[y * width + x] >= MASK_THRESHOLD;
    for y in 0..height {
        for x in 0..width {
            let open = (x > 0 && !inside(x - 1, y))
                || (x + 1 < width && !inside(x + 1, y))
                || (y > 0 && !inside(x, y - 1))
                || (y + 1 < height && !inside(x, y + 1));
            if inside(x, y) && open {
                image.pixels[y * width + x] = color;
            }
        }
    }
}

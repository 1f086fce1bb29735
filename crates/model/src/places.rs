//! Where tokens are, for attention that knows how they lie to each other and where a key shows in the query's picture
//! (docs/decisions/0012-depth-anchors.md).
//!
//! A *frame* is a rigid motion from a token's own space to model space: `[12]`, rotation row by row, then translation. A
//! patch has the frame of its middle ray: z along it, x to the picture's right, the origin where the ray comes nearest to
//! model space's. Learned tokens and lights have model space itself.
//!
//! A *depth anchor* is a point on a patch's ray. Seen from a query's view, it has coordinates there, by which queries and
//! keys are rotated (2-D RoPE; URoPE, arXiv 2604.18747), so that a score can pick a place in the picture. Tokens that are
//! of no view are not rotated.

use crate::turns::Turns;
use burn::tensor::Device;
use lumi_core::Camera;
use lumi_core::glam::{Mat3, Vec3};
use lumi_kernels::FRAME;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// Anchors along a patch's ray, from its point nearest to the origin; head `h` has the anchor `h mod 4`.
pub const DEPTHS: [f32; 4] = [-0.6, -0.2, 0.2, 0.6];
/// Lowest and highest angular frequency of the rotations, per focal length.
const FREQUENCIES: [f32; 2] = [2.0, 40.0];
/// Coordinates are kept within so many focal lengths, and depths above a least one: what lies behind or beside a camera is
/// far outside its picture, wherever exactly.
const FARTHEST: f32 = 4.0;
const NEAREST_DEPTH: f32 = 0.05;

/// Where the tokens of a batch of sequences are: first those of no view, then those of the views, view by view.
#[derive(Clone, Debug)]
pub struct Places {
    batch: usize,
    learned: usize,
    /// In model space, `[b, v]`.
    cameras: Vec<Camera>,
    /// `[b, learned + v·per_view, 12]`
    frames: Arc<Vec<f32>>,
    /// Point nearest to the origin and direction of each view token's ray, `[b, v·per_view]`.
    rays: Vec<[Vec3; 2]>,
}

impl Places {
    /// Of `learned` tokens without a place and the patches of each view, in the order of
    /// [`crate::network::patches`]: `[b, v]` cameras of one size in model space.
    ///
    /// # Panics
    /// If the cameras are not as many for each of the `batch` sequences.
    #[must_use]
    pub fn new(batch: usize, learned: usize, cameras: &[Camera], patch: usize) -> Self {
        assert!(
            batch > 0 && cameras.len().is_multiple_of(batch),
            "places: {} cameras of {batch} sequences",
            cameras.len()
        );
        let mut frames = Vec::new();
        let mut rays = Vec::new();
        let views = cameras.len() / batch;
        for b in 0..batch {
            frames.extend(MODEL_SPACE.repeat(learned));
            for camera in &cameras[b * views..(b + 1) * views] {
                for (frame, ray) in patch_rays(camera, patch) {
                    frames.extend(frame);
                    rays.push(ray);
                }
            }
        }
        Self {
            batch,
            learned,
            cameras: cameras.to_vec(),
            frames: Arc::new(frames),
            rays,
        }
    }

    /// Tokens of a sequence.
    #[must_use]
    pub fn tokens(&self) -> usize {
        self.learned + self.rays.len() / self.batch
    }

    fn views(&self) -> usize {
        self.cameras.len() / self.batch
    }

    fn per_view(&self) -> usize {
        self.rays.len() / self.cameras.len().max(1)
    }

    /// `[b, tokens, 12]`
    #[must_use]
    pub fn frames(&self) -> &Arc<Vec<f32>> {
        &self.frames
    }

    /// The cameras of sequence `b`, in model space.
    #[must_use]
    pub fn cameras(&self, b: usize) -> &[Camera] {
        &self.cameras[b * self.views()..][..self.views()]
    }

    /// Tokens without a place that each sequence begins with.
    #[must_use]
    pub fn learned(&self) -> usize {
        self.learned
    }

    /// What self-attention over these tokens and `lights` more behind them needs, for heads of `head_dim` channels.
    #[must_use]
    pub fn among_themselves(&self, lights: usize, head_dim: usize) -> Sight {
        let (n, views, per_view) = (self.tokens(), self.views(), self.per_view());
        let mut groups = vec![per_view; views];
        if self.learned > 0 {
            groups.insert(0, self.learned);
        }
        if lights > 0 {
            groups.push(lights);
        }
        let frames = match lights {
            0 => Arc::clone(&self.frames),
            _ => Arc::new(
                self.frames
                    .chunks_exact(n * FRAME)
                    .flat_map(|own| own.iter().copied().chain(MODEL_SPACE.repeat(lights)))
                    .collect(),
            ),
        };
        let wave = Waves::new(head_dim);
        let keys = Keys {
            of: self,
            total: n + lights,
        };
        let mut queries = wave.still(self.batch * (n + lights));
        wave.own_turns(self, n + lights, &mut queries);
        // Tokens of no view see keys as they are.
        let seen = |b: usize| {
            let views = self.cameras(b).iter().map(Some);
            let first = (self.learned > 0).then_some(None);
            let last = (lights > 0).then_some(None);
            first.into_iter().chain(views).chain(last).collect()
        };
        Sight {
            batch: self.batch,
            frames,
            context: None,
            groups,
            queries: Arc::new(queries),
            keys: Arc::new(wave.key_turns(&keys, seen)),
            tensors: OnceLock::new(),
        }
    }

    /// What keys and values made of these tokens need; queries bring the turns.
    #[must_use]
    pub fn as_keys(&self) -> Sight {
        Sight {
            batch: self.batch,
            frames: Arc::clone(&self.frames),
            context: None,
            groups: Vec::new(),
            queries: Arc::default(),
            keys: Arc::default(),
            tensors: OnceLock::new(),
        }
    }

    /// What these views' tokens need to attend to a scene's.
    #[must_use]
    pub fn toward(&self, scene: &Self, head_dim: usize) -> Sight {
        let wave = Waves::new(head_dim);
        let n = self.tokens();
        let mut queries = wave.still(self.batch * n);
        wave.own_turns(self, n, &mut queries);
        let keys = Keys {
            of: scene,
            total: scene.tokens(),
        };
        let seen = |b: usize| self.cameras(b).iter().map(Some).collect();
        Sight {
            batch: self.batch,
            frames: Arc::clone(&self.frames),
            context: Some(Arc::clone(&scene.frames)),
            groups: vec![self.per_view(); self.views()],
            queries: Arc::new(queries),
            keys: Arc::new(wave.key_turns(&keys, seen)),
            tensors: OnceLock::new(),
        }
    }
}

/// The frame of tokens that have no place of their own.
const MODEL_SPACE: [f32; FRAME] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];

/// Frame and ray (nearest point, direction) of each patch of a view, row by row.
fn patch_rays(
    camera: &Camera,
    patch: usize,
) -> impl Iterator<Item = ([f32; FRAME], [Vec3; 2])> + '_ {
    let (rows, columns, half) = (
        camera.height / patch,
        camera.width / patch,
        patch as f32 / 2.0,
    );
    (0..rows * columns).map(move |i| {
        let centre = |k: usize| (k * patch) as f32 + half;
        let (x, y) = (centre(i % columns), centre(i / columns));
        let z = camera.direction(x, y);
        let right = camera.direction(x + half, y) - camera.direction(x - half, y);
        let right = (right - right.dot(z) * z).normalize();
        let origin = camera.centre();
        let nearest = origin - origin.dot(z) * z;
        let rows = Mat3::from_cols(right, z.cross(right), z).transpose();
        let mut frame = [0.0; FRAME];
        frame[..9].copy_from_slice(&rows.to_cols_array());
        frame[9..].copy_from_slice(&nearest.to_array());
        (frame, [nearest, z])
    })
}

/// What attention needs to know of where its tokens are. `pairs` = head_dim / 4.
#[derive(Clone, Debug)]
pub struct Sight {
    /// Sequences b.
    pub batch: usize,
    /// Frames of the queries' tokens, `[b, n, 12]`.
    pub frames: Arc<Vec<f32>>,
    /// Frames of the context's tokens, `[b, m, 12]`, where keys are not the queries' own tokens.
    pub context: Option<Arc<Vec<f32>>>,
    /// Lengths of the groups of queries; keys are turned for each.
    pub groups: Vec<usize>,
    /// Cosine and sine of each query's turns, `[b, n, pairs, 2]`.
    pub queries: Arc<Vec<f32>>,
    /// The same of each key for each group and depth, `[b, groups, 4, m, pairs, 2]`.
    pub keys: Arc<Vec<f32>>,
    /// What Burn's operations need instead, made by the first block that they run.
    tensors: OnceLock<Turns>,
}

impl Sight {
    /// Frames of the tokens that keys are made of.
    pub(crate) fn keys_frames(&self) -> &Arc<Vec<f32>> {
        self.context.as_ref().unwrap_or(&self.frames)
    }

    /// The same for Burn's operations.
    pub(crate) fn turns(&self, device: &Device) -> &Turns {
        self.tensors.get_or_init(|| Turns::new(self, device))
    }
}

struct Keys<'a> {
    of: &'a Places,
    /// Its tokens and those without a place behind them.
    total: usize,
}

/// The frequencies of a head's turns: the first half of its pairs turns with the horizontal coordinate, the other with
/// the vertical one.
struct Waves {
    pairs: usize,
    frequencies: Vec<f32>,
}

impl Waves {
    fn new(head_dim: usize) -> Self {
        let pairs = head_dim / 4;
        let each = pairs / 2;
        let [low, high] = FREQUENCIES;
        let step = |k: usize| (high / low).powf(k as f32 / (each.max(2) - 1) as f32);
        Self {
            pairs,
            frequencies: (0..each).map(|k| low * step(k)).collect(),
        }
    }

    /// Turns of nothing for `n` tokens.
    fn still(&self, n: usize) -> Vec<f32> {
        [1.0, 0.0].repeat(n * self.pairs)
    }

    fn turn(&self, at: [f32; 2], out: &mut [f32]) {
        let angles = at
            .iter()
            .flat_map(|c| self.frequencies.iter().map(move |f| c * f));
        for (pair, angle) in out.chunks_exact_mut(2).zip(angles) {
            let (sine, cosine) = angle.sin_cos();
            pair.copy_from_slice(&[cosine, sine]);
        }
    }

    /// Turns of view tokens by where they are in their own views; sequences of `n` tokens.
    fn own_turns(&self, places: &Places, n: usize, out: &mut [f32]) {
        let width = 2 * self.pairs;
        let of_views = places.tokens() - places.learned;
        for b in 0..places.batch {
            for i in 0..of_views {
                let camera = &places.cameras(b)[i / places.per_view()];
                let [nearest, _] = places.rays[b * of_views + i];
                let at = (b * n + places.learned + i) * width;
                self.turn(seen_at(camera, nearest), &mut out[at..at + width]);
            }
        }
    }

    /// Turns of all keys for each group of queries, which see through a camera or have none.
    fn key_turns<'a>(
        &self,
        keys: &Keys,
        seen: impl Fn(usize) -> Vec<Option<&'a Camera>>,
    ) -> Vec<f32> {
        let (places, width) = (keys.of, 2 * self.pairs);
        let of_views = places.tokens() - places.learned;
        let groups: Vec<Vec<Option<&Camera>>> = (0..places.batch).map(seen).collect();
        let each = groups.first().map_or(0, Vec::len);
        let block = keys.total * width;
        let mut turns = self.still(places.batch * each * DEPTHS.len() * keys.total);
        turns
            .par_chunks_mut((DEPTHS.len() * block).max(1))
            .enumerate()
            .for_each(|(i, turns)| {
                let b = i / each;
                let Some(camera) = groups[b][i % each] else {
                    return;
                };
                for (turns, depth) in turns.chunks_exact_mut(block).zip(DEPTHS) {
                    let rays = &places.rays[b * of_views..][..of_views];
                    let turns = turns[places.learned * width..].chunks_exact_mut(width);
                    for (out, [nearest, direction]) in turns.zip(rays) {
                        let point = *nearest + depth * *direction;
                        self.turn(seen_at(camera, point), out);
                    }
                }
            });
        turns
    }
}

/// Where a point of model space is in a camera's picture, in focal lengths from the centre.
fn seen_at(camera: &Camera, point: Vec3) -> [f32; 2] {
    let to_camera = Mat3::from_mat4(camera.camera_to_world).transpose();
    let p = to_camera * (point - camera.centre());
    let depth = p.z.max(NEAREST_DEPTH);
    [p.x, p.y].map(|c| (c / depth).clamp(-FARTHEST, FARTHEST))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(i: usize) -> Camera {
        Camera::orbit(0.7 + i as f32, 0.4, 2.75, 0.87, 16)
    }

    #[test]
    fn a_patch_has_the_frame_of_its_middle_ray() {
        let camera = camera(0);
        let places = Places::new(1, 2, &[camera], 4);
        assert_eq!(places.tokens(), 2 + 16);
        let frames: Vec<_> = places.frames.chunks_exact(FRAME).collect();
        assert_eq!(frames[..2], [&MODEL_SPACE[..]; 2]);
        for (i, frame) in frames[2..].iter().enumerate() {
            let column = |c: usize| Vec3::new(frame[c], frame[3 + c], frame[6 + c]);
            let [x, y, z] = [0, 1, 2].map(column);
            let middle = [i % 4, i / 4].map(|k| 4.0 * k as f32 + 2.0);
            let ray = camera.direction(middle[0], middle[1]);
            assert!((z - ray).length() < 1e-6, "patch {i}");
            let right = camera.direction(middle[0] + 1.0, middle[1]) - ray;
            assert!(x.dot(right.normalize()) > 0.99, "patch {i}");
            for (a, b, want) in [(x, x, 1.0), (y, y, 1.0), (x, y, 0.0), (x, z, 0.0)] {
                assert!((a.dot(b) - want).abs() < 1e-5, "patch {i}");
            }
            assert!((x.cross(y) - z).length() < 1e-5, "patch {i}: left-handed");
            // The origin is on the middle ray, at its point nearest to the model space's.
            let origin = Vec3::new(frame[9], frame[10], frame[11]);
            assert!(origin.dot(z).abs() < 1e-4, "patch {i}");
            let off = (origin - camera.centre()).cross(z).length();
            assert!(off < 1e-4, "patch {i}: {off}");
        }
    }

    /// The angle of the slowest horizontal turn tells a coordinate.
    fn horizontal(turns: &[f32]) -> f32 {
        turns[1].atan2(turns[0]) / FREQUENCIES[0]
    }

    #[test]
    fn keys_are_turned_by_where_their_anchors_show() {
        let (scene, target) = ([camera(0), camera(1)], camera(2));
        let (places, views) = (
            Places::new(1, 3, &scene, 4),
            Places::new(1, 0, &[target], 4),
        );
        let sight = views.toward(&places, 32);
        let (width, m) = (16, places.tokens());
        assert_eq!(sight.keys.len(), DEPTHS.len() * m * width);
        assert_eq!(sight.groups, [16]);
        for (k, depth) in DEPTHS.into_iter().enumerate() {
            let turns = |token: usize| &sight.keys[(k * m + token) * width..][..width];
            assert_eq!(turns(1), [1.0, 0.0].repeat(8), "of no view, so not turned");
            for i in 0..16 {
                let camera = &scene[1];
                let [x, y] = [i % 4, i / 4].map(|k| 4.0 * k as f32 + 2.0);
                let d = camera.direction(x, y);
                let nearest = camera.centre() - camera.centre().dot(d) * d;
                let (u, _, _) = target.project(nearest + depth * d);
                let expected = (u - target.cx) / target.fx;
                let found = horizontal(turns(3 + 16 + i));
                assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
            }
        }
        // A query is turned by its own place in its own view.
        let found = horizontal(&sight.queries[..width]);
        assert!((found - (2.0 - target.cx) / target.fx).abs() < 1e-5);
    }

    #[test]
    fn a_views_own_keys_are_turned_as_its_queries() {
        let places = Places::new(2, 3, &[camera(0), camera(1), camera(2), camera(3)], 4);
        let sight = places.among_themselves(2, 32);
        assert_eq!(sight.groups, [3, 16, 16, 2]);
        let (n, width) = (3 + 32 + 2, 16);
        let keys = |b: usize, g: usize, k: usize| {
            &sight.keys[((b * 4 + g) * DEPTHS.len() + k) * n * width..][..n * width]
        };
        for b in 0..2 {
            let queries = &sight.queries[b * n * width..][..n * width];
            for k in 0..DEPTHS.len() {
                let own = (3 + 16) * width..(3 + 32) * width;
                for (a, b) in keys(b, 2, k)[own.clone()].iter().zip(&queries[own]) {
                    assert!((a - b).abs() < 2e-4, "{a} and {b}");
                }
                // Tokens of no view see every key as it is.
                assert_eq!(keys(b, 0, k), [1.0, 0.0].repeat(n * width / 2));
                assert_eq!(keys(b, 3, k), [1.0, 0.0].repeat(n * width / 2));
            }
        }
    }
}

//! Image textures: pixels as files have them, looked up as glTF's samplers say.

use lumi_core::color::srgb_decode;
use lumi_core::glam::{Affine2, Vec2, Vec4};
use std::sync::{Arc, LazyLock};

/// Pixels of an image as bytes, with how they are meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Width in pixels, at least 1.
    pub width: usize,
    /// Height in pixels, at least 1.
    pub height: usize,
    /// Row-major RGBA from the top left.
    pub pixels: Vec<[u8; 4]>,
    /// Whether red, green and blue are sRGB-encoded; alpha never is.
    pub srgb: bool,
}

/// What lies outside of [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat,
    /// The image mirrored every other time.
    Mirror,
    /// The pixels of the edge.
    Clamp,
}

/// An image with its sampler and its place in texture space.
#[derive(Clone, Debug)]
pub struct Texture {
    /// The pixels.
    pub image: Arc<Image>,
    /// Along u and v.
    pub wrap: [Wrap; 2],
    /// Whether the nearest pixel is taken instead of a blend of four.
    pub nearest: bool,
    /// Which of a surface's two sets of texture coordinates, 0 or 1.
    pub set: usize,
    /// From texture coordinates to the image, whose top left is (0, 0) and bottom right (1, 1).
    pub transform: Affine2,
}

static DECODE: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| srgb_decode(i as f32 / 255.0)));

impl Image {
    /// A decoded file.
    #[must_use]
    pub fn new(source: &image::RgbaImage, srgb: bool) -> Self {
        Self {
            width: source.width() as usize,
            height: source.height() as usize,
            pixels: source.pixels().map(|p| p.0).collect(),
            srgb,
        }
    }

    /// Whether no pixel has a hue.
    #[must_use]
    pub fn is_grey(&self) -> bool {
        self.pixels.iter().all(|[r, g, b, _]| r == g && g == b)
    }

    /// Opacity per pixel of an image that is a mask: its alpha, or its brightness if it is opaque everywhere.
    fn opacities(&self) -> impl Fn(usize, usize) -> u8 {
        let brightness = self.pixels.iter().all(|p| p[3] == 255);
        move |x, y| {
            let [r, g, b, a] = self.pixels[y * self.width + x];
            if brightness {
                ((u16::from(r) + u16::from(g) + u16::from(b)) / 3) as u8
            } else {
                a
            }
        }
    }

    /// White with the opacity of this mask.
    #[must_use]
    pub fn white_masked(&self) -> Self {
        let white = Self {
            pixels: vec![[255; 4]; self.pixels.len()],
            ..self.clone()
        };
        white.masked_by(self)
    }

    /// This image with the opacity of a mask, which may have another size.
    #[must_use]
    pub fn masked_by(&self, mask: &Self) -> Self {
        let opacity = mask.opacities();
        let mut made = self.clone();
        for (i, pixel) in made.pixels.iter_mut().enumerate() {
            let (x, y) = (i % self.width, i / self.width);
            let scaled = |v: usize, n: usize, m: usize| (2 * v + 1) * m / (2 * n);
            let x = scaled(x, self.width, mask.width);
            pixel[3] = opacity(x, scaled(y, self.height, mask.height));
        }
        made
    }

    /// Linear values of a pixel.
    fn at(&self, x: usize, y: usize) -> Vec4 {
        let [r, g, b, a] = self.pixels[y * self.width + x];
        let alpha = f32::from(a) / 255.0;
        if self.srgb {
            let [r, g, b] = [r, g, b].map(|v| DECODE[usize::from(v)]);
            Vec4::new(r, g, b, alpha)
        } else {
            let [r, g, b] = [r, g, b].map(|v| f32::from(v) / 255.0);
            Vec4::new(r, g, b, alpha)
        }
    }
}

impl Wrap {
    fn apply(self, i: i64, n: usize) -> usize {
        let n = n as i64;
        let j = match self {
            Self::Repeat => i.rem_euclid(n),
            Self::Mirror => {
                let k = i.rem_euclid(2 * n);
                k.min(2 * n - 1 - k)
            }
            Self::Clamp => i.clamp(0, n - 1),
        };
        j as usize
    }
}

impl Texture {
    /// An image that repeats over the first set of texture coordinates.
    #[must_use]
    pub fn new(image: Arc<Image>) -> Self {
        Self {
            image,
            wrap: [Wrap::Repeat; 2],
            nearest: false,
            set: 0,
            transform: Affine2::IDENTITY,
        }
    }

    /// The same place in another image.
    #[must_use]
    pub fn showing(&self, image: Image) -> Self {
        Self {
            image: Arc::new(image),
            ..self.clone()
        }
    }

    /// Linear RGBA at a surface's texture coordinates. Pixels are averaged by the paths of a pixel, so there are no
    /// smaller copies of the image (minification filters do nothing).
    #[must_use]
    pub fn lookup(&self, uv: &[Vec2; 2]) -> Vec4 {
        let p = self.transform.transform_point2(uv[self.set]);
        // Far outside a float has no fraction left, and beyond 2⁶³ no integer.
        let p = if p.is_finite() && p.abs().max_element() < 1e6 {
            p
        } else {
            Vec2::ZERO
        };
        let image = &*self.image;
        let size = Vec2::new(image.width as f32, image.height as f32);
        let pixel = |x: i64, y: i64| {
            let x = self.wrap[0].apply(x, image.width);
            image.at(x, self.wrap[1].apply(y, image.height))
        };
        if self.nearest {
            let q = (p * size).floor();
            return pixel(q.x as i64, q.y as i64);
        }
        let q = p * size - 0.5;
        let corner = q.floor();
        let t = q - corner;
        let (x, y) = (corner.x as i64, corner.y as i64);
        let top = pixel(x, y).lerp(pixel(x + 1, y), t.x);
        let bottom = pixel(x, y + 1).lerp(pixel(x + 1, y + 1), t.x);
        top.lerp(bottom, t.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four pixels in a row: 0, 51, 102, 153.
    fn ramp() -> Texture {
        let pixels = [0, 51, 102, 153].map(|v| [v, v, v, 255]);
        Texture::new(Arc::new(Image {
            width: 4,
            height: 1,
            pixels: pixels.into(),
            srgb: false,
        }))
    }

    #[test]
    fn wraps_and_filters_as_asked() {
        let mut texture = ramp();
        let at = |t: &Texture, u: f32| t.lookup(&[Vec2::new(u, 0.5), Vec2::ZERO]).x;
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} {b}");
        // Pixel centres, then halfway between two, then across the seam.
        close(at(&texture, 0.125), 0.0);
        close(at(&texture, 0.375), 0.2);
        close(at(&texture, 0.5), 0.3);
        close(at(&texture, 1.0), 0.3);
        close(at(&texture, 1.375), 0.2);
        close(at(&texture, -0.625), 0.2);
        texture.wrap = [Wrap::Clamp; 2];
        close(at(&texture, 1.7), 0.6);
        close(at(&texture, -0.3), 0.0);
        texture.wrap = [Wrap::Mirror; 2];
        close(at(&texture, 1.125), 0.6);
        close(at(&texture, 1.625), 0.2);
        close(at(&texture, -0.375), 0.2);
        texture.nearest = true;
        close(at(&texture, 0.49), 0.2);
        close(at(&texture, 0.51), 0.4);
        close(at(&texture, 1.01), 0.6);
    }

    #[test]
    fn masks_are_alpha_or_else_brightness() {
        let image = |pixels: &[[u8; 4]]| Image {
            width: pixels.len(),
            height: 1,
            pixels: pixels.to_vec(),
            srgb: true,
        };
        let red = image(&[[255, 0, 0, 255]; 4]);
        let alphas = |i: &Image| i.pixels.iter().map(|p| p[3]).collect::<Vec<_>>();
        let grey = image(&[[0, 0, 0, 255], [90, 90, 90, 255]]);
        assert_eq!(alphas(&red.masked_by(&grey)), [0, 0, 90, 90]);
        assert_eq!(red.masked_by(&grey).pixels[3], [255, 0, 0, 90]);
        let clear = image(&[[255, 255, 255, 7], [255, 255, 255, 255]]);
        assert_eq!(clear.white_masked().pixels, [[255, 255, 255, 7], [255; 4]]);
        assert!(grey.is_grey() && !red.is_grey());
    }

    #[test]
    fn transforms_and_colours_are_applied_and_wild_coordinates_are_safe() {
        let mut texture = ramp();
        texture.transform =
            Affine2::from_scale_angle_translation(Vec2::new(0.5, 1.0), 0.0, Vec2::new(0.25, 0.0));
        texture.set = 1;
        let v = texture.lookup(&[Vec2::ZERO, Vec2::new(0.25, 0.0)]);
        assert!((v.x - 0.2).abs() < 1e-5, "{v}");
        for u in [f32::NAN, f32::INFINITY, -1e30, 1e20] {
            assert!(texture.lookup(&[Vec2::splat(u); 2]).is_finite());
        }
        let srgb = Image {
            srgb: true,
            ..(*texture.image).clone()
        };
        let v = srgb.at(2, 0);
        assert!((v.x - srgb_decode(0.4)).abs() < 1e-6 && v.w == 1.0);
    }
}

//! How many floating-point operations a network takes, counted from its config.
//!
//! A multiplication with an addition is two operations. Counted are the matrix products of blocks, attention and heads;
//! norms, softmax and tokenizers are a few percent more.

use crate::ModelConfig;
use crate::config::{DecoderAttention, HeadConfig};

impl ModelConfig {
    /// Operations of `layers` blocks over `tokens` tokens of which each sees `seen`.
    fn blocks_flops(&self, layers: usize, tokens: usize, seen: usize) -> f64 {
        let (d, streams) = (self.dim as f64, self.streams as f64);
        let matrices = (4.0 + 20.0 / streams) * d * d;
        layers as f64 * tokens as f64 * (matrices + 4.0 * seen as f64 * d)
    }

    /// Tokens of one view of `resolution × resolution` pixels.
    fn tokens_of_view(&self, resolution: usize) -> usize {
        self.image_tokens(resolution, resolution)
    }

    /// Operations that encoding one scene from `inputs` views takes.
    #[must_use]
    pub fn encode_flops(&self, inputs: usize, resolution: usize) -> f64 {
        let n = self.scene_tokens + inputs * self.tokens_of_view(resolution);
        self.blocks_flops(self.encoder_layers, n, n)
    }

    /// Scene tokens from `inputs` views.
    #[must_use]
    pub fn scene_of(&self, inputs: usize, resolution: usize) -> usize {
        self.scene_length(inputs * self.tokens_of_view(resolution))
    }

    /// Operations that one edit of `scene` tokens with `lights` light tokens takes.
    #[must_use]
    pub fn edit_flops(&self, scene: usize, lights: usize) -> f64 {
        let n = scene + lights;
        self.blocks_flops(self.editor_layers, n, n)
    }

    /// Operations that the decoder's blocks take for `targets` views of one scene of `scene` tokens.
    #[must_use]
    pub fn decode_flops(&self, scene: usize, targets: usize, resolution: usize) -> f64 {
        let (layers, d, k) = (self.decoder_layers, self.dim as f64, scene);
        let n = self.tokens_of_view(resolution);
        match self.decoder {
            DecoderAttention::Joint => targets as f64 * self.blocks_flops(layers, k + n, k + n),
            DecoderAttention::OneWay => {
                // Keys and values of the scene's tokens.
                let context = (2.0 + 2.0 / self.streams as f64) * d * d;
                layers as f64 * k as f64 * context + self.blocks_flops(layers, targets * n, k + n)
            }
        }
    }

    /// Operations of what finishes a pixel.
    fn pixel_flops(&self) -> f64 {
        let [_, direct, carried] = self.target_parts();
        let (inputs, width) = (
            self.head_channels() + direct + carried,
            self.pixel_mlp as f64,
        );
        let context = 9.0 * self.pixel_context as f64 * width;
        2.0 * width * (inputs as f64 + width + context + self.output.channels() as f64 * 2.0)
    }

    /// Operations of the head for one view.
    #[must_use]
    pub fn head_flops(&self, resolution: usize) -> f64 {
        let n = self.tokens_of_view(resolution) as f64;
        let (d, p) = (self.dim as f64, self.patch as f64);
        match &self.head {
            HeadConfig::Mlp => {
                n * p * p * (2.0 * d * self.head_channels() as f64 + self.pixel_flops())
            }
            HeadConfig::Dpt { features, layers } => {
                let (f, l) = (*features as f64, layers.len() as f64);
                let convolutions = (2.0 * l + 2.0 * (l - 1.0)) * 18.0 * f * f;
                n * (l * 2.0 * d * f + convolutions + 2.0 * f * 3.0 * p * p)
            }
            HeadConfig::DptPyramid { features, layers } => {
                let f = *features as f64;
                let maps: f64 = (0..layers.len())
                    .map(|i| {
                        let cells = n * 4_f64.powi(i as i32);
                        cells * (2.0 * d * f + 2.0 * 18.0 * f * f)
                    })
                    .sum();
                // From the finest map to full resolution in factors of two.
                let (mut scale, mut enlarging) = (2_f64.powi(layers.len() as i32 - 1), 0.0);
                while 2.0 * scale <= p {
                    scale *= 2.0;
                    enlarging += n * scale * scale * 18.0 * f * f;
                }
                maps + enlarging + n * p * p * 18.0 * f * 3.0
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures that the papers' sizes are known by.
    #[test]
    fn published_sizes() {
        let model = ModelConfig::preset("authors-512-dpt").expect("preset");
        let stages = [
            (model.encode_flops(4, 512), 17.3),
            (model.encode_flops(4, 256), 3.1),
            (model.edit_flops(3072, 2048), 1.84),
            (model.decode_flops(3072, 1, 512), 3.1),
            (model.decode_flops(3072, 1, 256), 1.31),
        ];
        let near = |flops: f64, known: f64, share: f64| {
            assert!((flops / known - 1.0).abs() < share, "{flops} for {known}");
        };
        for (flops, tera) in stages {
            // As exactly as they are known.
            near(flops, 1e12 * tera, 0.005);
        }
        // Known figures of this head are 2 to 4 % above its matrix products, which are all that is counted here.
        near(model.head_flops(512), 77e9, 0.04);
        near(model.head_flops(256), 19e9, 0.04);
    }
}

//! One seed, many named random streams.

use rand::SeedableRng;

/// The generator behind every stream.
pub type Rng = rand_pcg::Pcg64Mcg;

/// A seed from which independent streams are derived by name and index, so that adding a consumer
/// never changes what the others draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed(pub u64);

impl Seed {
    /// The seed of a named child.
    #[must_use]
    pub fn child(self, name: &str) -> Self {
        // FNV-1a over the name, then a SplitMix64 finaliser to spread it over all bits.
        let hash = name.bytes().fold(self.0 ^ 0xcbf2_9ce4_8422_2325, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        Self(split_mix(hash))
    }

    /// The seed of the `index`-th child.
    #[must_use]
    pub fn index(self, index: u64) -> Self {
        Self(split_mix(
            self.0 ^ split_mix(index.wrapping_add(0x9e37_79b9_7f4a_7c15)),
        ))
    }

    /// A generator for this seed's stream called `name`.
    #[must_use]
    pub fn stream(self, name: &str) -> Rng {
        Rng::seed_from_u64(self.child(name).0)
    }
}

fn split_mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_and_repeat() {
        let s = Seed(7);
        assert_eq!(s.child("a"), s.child("a"));
        assert_ne!(s.child("a"), s.child("b"));
        assert_ne!(s.index(0), s.index(1));
        assert_ne!(Seed(1).child("a"), Seed(2).child("a"));
    }
}

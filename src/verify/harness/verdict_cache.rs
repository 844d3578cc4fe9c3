//! Cache of oracle verdicts: most variants return the same hit for most rays, and the exact oracle is expensive.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::correctness::Correctness;
use crate::accel::Hit;

/// Largest number of verdicts that are kept of a case; each takes 40 bytes.
const MAX_VERDICTS: usize = 1 << 24;

/// Result of a query with the oracle's verdict.
#[derive(Clone, Copy, Debug)]
pub(super) struct CachedVerdict {
    pub(super) hit: Option<Hit>,
    pub(super) correctness: Correctness,
    /// Error of the result, in the unit of the case; 0 if the case measures none.
    pub(super) error: f64,
}

impl CachedVerdict {
    /// Returns the verdict if it was given for exactly this hit, bit for bit.
    pub(super) fn of(&self, hit: Option<Hit>) -> Option<CachedVerdict> {
        // Compare bits, because -0 == 0 and NaN != NaN
        (bits(self.hit) == bits(hit)).then_some(*self)
    }
}

fn bits(hit: Option<Hit>) -> Option<[u32; 5]> {
    let hit = hit?;
    let [t, u, v] = [hit.t, hit.u, hit.v].map(f32::to_bits);
    Some([hit.instance, hit.primitive, t, u, v])
}

/// Key of a chunk: the seed of the part of a case, and the number of the chunk.
type VerdictChunk = (u64, u64);

/// Verdicts on the first variant's results for each chunk of a case's rays, reused for the variants that follow.
///
/// A cache serves one case with one number of rays, whose queries and oracle are identical on every variant.
#[derive(Debug, Default)]
pub struct VerdictCache {
    chunks: Mutex<HashMap<VerdictChunk, Arc<[CachedVerdict]>>>,
}

impl VerdictCache {
    /// Returns the verdicts on a chunk in the order of its rays; empty if there are none or the cache was full.
    pub(super) fn lookup(&self, chunk: VerdictChunk) -> Arc<[CachedVerdict]> {
        let chunks = self.chunks.lock().unwrap_or_else(PoisonError::into_inner);
        chunks.get(&chunk).cloned().unwrap_or_default()
    }

    /// Stores the verdicts on a chunk, unless it has some already or the cache is full.
    pub(super) fn keep(&self, chunk: VerdictChunk, cached_verdicts: Vec<CachedVerdict>) {
        let mut chunks = self.chunks.lock().unwrap_or_else(PoisonError::into_inner);
        // Bound the memory by assuming chunks of equal size
        if chunks.len().saturating_mul(cached_verdicts.len()) < MAX_VERDICTS {
            chunks.entry(chunk).or_insert_with(|| cached_verdicts.into());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HIT: Hit = Hit {
        instance: 1,
        primitive: 2,
        t: 3.0,
        u: 0.25,
        v: 0.0,
    };

    #[test]
    fn cached_verdict_applies_only_to_identical_bits() {
        let said = |hit| CachedVerdict {
            hit,
            correctness: Correctness::Tie,
            error: 0.5,
        };
        let of = |kept, hit| said(kept).of(hit).map(|said| said.error);
        assert_eq!(of(Some(HIT), Some(HIT)), Some(0.5));
        assert_eq!(of(None, None), Some(0.5));
        // Change each field of the hit by itself
        for other in [
            Hit { instance: 0, ..HIT },
            Hit { primitive: 0, ..HIT },
            Hit {
                t: 3f32.next_up(),
                ..HIT
            },
            Hit { u: 0.5, ..HIT },
            Hit { v: -0.0, ..HIT },
        ] {
            assert_eq!(of(Some(HIT), Some(other)), None, "{other:?}");
        }
        assert_eq!(of(Some(HIT), None), None);
        assert_eq!(of(None, Some(HIT)), None);
    }

    #[test]
    fn first_results_are_cached_by_chunk_up_to_the_limit() {
        let said = |error, count| {
            let cached_verdict = CachedVerdict {
                hit: None,
                correctness: Correctness::Right,
                error,
            };
            vec![cached_verdict; count]
        };
        let verdict_cache = VerdictCache::default();
        assert!(verdict_cache.lookup((1, 0)).is_empty());
        verdict_cache.keep((1, 0), said(1.0, 2));
        // The second verdicts on a chunk are ignored, and too large a chunk is not kept
        verdict_cache.keep((1, 0), said(2.0, 2));
        verdict_cache.keep((1, 1), said(3.0, 1));
        verdict_cache.keep((1, 2), said(4.0, MAX_VERDICTS));
        let errors = |chunk| {
            verdict_cache
                .lookup(chunk)
                .iter()
                .map(|said| said.error)
                .collect::<Vec<_>>()
        };
        assert_eq!(errors((1, 0)), [1.0, 1.0]);
        assert_eq!(errors((1, 1)), [3.0]);
        assert!(errors((1, 2)).is_empty());
    }
}

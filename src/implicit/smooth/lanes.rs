//! Sixteen numbers at a time: what the fit's inner loops are made of, in the processor's widest vectors.
//!
//! All kinds of [`Lanes`] add in the same order, and those that fuse products and sums round once: processors with AVX2, with
//! AVX-512 and of the ARM kind come to the same bytes.

/// Sixteen numbers in memory.
pub(super) type Line = [f32; 16];

/// Operations on sixteen numbers.
pub(super) trait Lanes: Copy + Send + Sync {
    /// Sixteen numbers in registers.
    type Wide: Copy;

    fn load(self, x: &Line) -> Self::Wide;
    fn store(self, v: Self::Wide) -> Line;
    fn splat(self, x: f32) -> Self::Wide;
    fn add(self, a: Self::Wide, b: Self::Wide) -> Self::Wide;
    fn sub(self, a: Self::Wide, b: Self::Wide) -> Self::Wide;
    fn mul(self, a: Self::Wide, b: Self::Wide) -> Self::Wide;
    /// a b + c, rounded once where the processor can.
    fn mul_add(self, a: Self::Wide, b: Self::Wide, c: Self::Wide) -> Self::Wide;
    /// Each lane's next one; 0 in the last.
    fn next(self, v: Self::Wide) -> Self::Wide;
    /// Each lane's previous one; 0 in the first.
    fn previous(self, v: Self::Wide) -> Self::Wide;
    /// The lanes whose bit is set; 0 in the others.
    fn keep(self, v: Self::Wide, bits: u16) -> Self::Wide;
    /// The sums of the lanes of four.
    fn sums(self, v: [Self::Wide; 4]) -> [f32; 4];
    /// Four pieces of four, one behind the other.
    fn join(self, pieces: [[f32; 4]; 4]) -> Self::Wide;
}

/// A loop over many lines.
///
/// Without closures in it that work on [`Lanes::Wide`]: the compiler makes functions of them that do not know the processor.
pub(super) trait Job {
    type Output;
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs a job with the widest lanes that the processor has.
pub(super) fn dispatch<J: Job>(job: J) -> J::Output {
    match pulp::Arch::new() {
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V4(v) => pulp::Simd::vectorize(v, With { job, lanes: v }),
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V3(v) => pulp::Simd::vectorize(v, With { job, lanes: v }),
        other => other.dispatch(With { job, lanes: Plain }),
    }
}

struct With<J, L> {
    job: J,
    lanes: L,
}

impl<J: Job, L: Lanes> pulp::WithSimd for With<J, L> {
    type Output = J::Output;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> J::Output {
        self.job.run(self.lanes)
    }
}

/// For processors of which nothing is known: the compiler makes of it what it can.
#[derive(Debug, Clone, Copy)]
struct Plain;

#[inline(always)]
fn each(f: impl FnMut(usize) -> f32) -> Line {
    std::array::from_fn(f)
}

impl Lanes for Plain {
    type Wide = Line;

    #[inline(always)]
    fn load(self, x: &Line) -> Line {
        *x
    }

    #[inline(always)]
    fn store(self, v: Line) -> Line {
        v
    }

    #[inline(always)]
    fn splat(self, x: f32) -> Line {
        [x; 16]
    }

    #[inline(always)]
    fn add(self, a: Line, b: Line) -> Line {
        each(|i| a[i] + b[i])
    }

    #[inline(always)]
    fn sub(self, a: Line, b: Line) -> Line {
        each(|i| a[i] - b[i])
    }

    #[inline(always)]
    fn mul(self, a: Line, b: Line) -> Line {
        each(|i| a[i] * b[i])
    }

    #[inline(always)]
    fn mul_add(self, a: Line, b: Line, c: Line) -> Line {
        if cfg!(target_arch = "aarch64") { each(|i| a[i].mul_add(b[i], c[i])) } else { each(|i| a[i] * b[i] + c[i]) }
    }

    #[inline(always)]
    fn next(self, v: Line) -> Line {
        each(|i| if i < 15 { v[i + 1] } else { 0.0 })
    }

    #[inline(always)]
    fn previous(self, v: Line) -> Line {
        each(|i| if i > 0 { v[i - 1] } else { 0.0 })
    }

    #[inline(always)]
    fn keep(self, v: Line, bits: u16) -> Line {
        each(|i| if bits >> i & 1 == 1 { v[i] } else { 0.0 })
    }

    #[inline(always)]
    fn sums(self, v: [Line; 4]) -> [f32; 4] {
        v.map(|v| {
            let quarter: [f32; 4] = std::array::from_fn(|i| (v[i] + v[i + 8]) + (v[i + 4] + v[i + 12]));
            (quarter[0] + quarter[1]) + (quarter[2] + quarter[3])
        })
    }

    #[inline(always)]
    fn join(self, pieces: [[f32; 4]; 4]) -> Line {
        each(|i| pieces[i / 4][i % 4])
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{__m128, __m256, __m512};

    use pulp::cast;
    use pulp::x86::{V3, V4};

    use super::{Lanes, Line};

    impl Lanes for V4 {
        type Wide = __m512;

        #[inline(always)]
        fn load(self, x: &Line) -> __m512 {
            cast(*x)
        }

        #[inline(always)]
        fn store(self, v: __m512) -> Line {
            cast(v)
        }

        #[inline(always)]
        fn splat(self, x: f32) -> __m512 {
            self.avx512f._mm512_set1_ps(x)
        }

        #[inline(always)]
        fn add(self, a: __m512, b: __m512) -> __m512 {
            self.avx512f._mm512_add_ps(a, b)
        }

        #[inline(always)]
        fn sub(self, a: __m512, b: __m512) -> __m512 {
            self.avx512f._mm512_sub_ps(a, b)
        }

        #[inline(always)]
        fn mul(self, a: __m512, b: __m512) -> __m512 {
            self.avx512f._mm512_mul_ps(a, b)
        }

        #[inline(always)]
        fn mul_add(self, a: __m512, b: __m512, c: __m512) -> __m512 {
            self.avx512f._mm512_fmadd_ps(a, b, c)
        }

        #[inline(always)]
        fn next(self, v: __m512) -> __m512 {
            let places = cast([1u32, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 15]);
            self.avx512f._mm512_maskz_permutexvar_ps(0x7fff, places, v)
        }

        #[inline(always)]
        fn previous(self, v: __m512) -> __m512 {
            let places = cast([0u32, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]);
            self.avx512f._mm512_maskz_permutexvar_ps(0xfffe, places, v)
        }

        #[inline(always)]
        fn keep(self, v: __m512, bits: u16) -> __m512 {
            self.avx512f._mm512_maskz_mov_ps(bits, v)
        }

        #[inline(always)]
        fn sums(self, [a, b, c, d]: [__m512; 4]) -> [f32; 4] {
            let f = self.avx512f;
            // Halves of a and b, then of c and d; quarters of all four; then within the quarters.
            let ab = f._mm512_add_ps(f._mm512_shuffle_f32x4::<0b01_00_01_00>(a, b), f._mm512_shuffle_f32x4::<0b11_10_11_10>(a, b));
            let cd = f._mm512_add_ps(f._mm512_shuffle_f32x4::<0b01_00_01_00>(c, d), f._mm512_shuffle_f32x4::<0b11_10_11_10>(c, d));
            let quarters = f._mm512_add_ps(f._mm512_shuffle_f32x4::<0b10_00_10_00>(ab, cd), f._mm512_shuffle_f32x4::<0b11_01_11_01>(ab, cd));
            let pairs = f._mm512_add_ps(quarters, f._mm512_permute_ps::<0b10_11_00_01>(quarters));
            let sums = f._mm512_add_ps(pairs, f._mm512_permute_ps::<0b01_00_11_10>(pairs));
            let sums: Line = cast(f._mm512_permutexvar_ps(cast([0u32, 4, 8, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]), sums));
            [sums[0], sums[1], sums[2], sums[3]]
        }

        #[inline(always)]
        fn join(self, pieces: [[f32; 4]; 4]) -> __m512 {
            let f = self.avx512f;
            let v = f._mm512_castps128_ps512(cast(pieces[0]));
            let v = f._mm512_insertf32x4::<1>(v, cast(pieces[1]));
            let v = f._mm512_insertf32x4::<2>(v, cast(pieces[2]));
            f._mm512_insertf32x4::<3>(v, cast(pieces[3]))
        }
    }

    /// The sums of the lanes four apart.
    #[inline(always)]
    fn quarters(v: V3, [low, high]: [__m256; 2]) -> __m128 {
        let half = v.avx._mm256_add_ps(low, high);
        v.sse._mm_add_ps(v.avx._mm256_castps256_ps128(half), v.avx._mm256_extractf128_ps::<1>(half))
    }

    impl Lanes for V3 {
        type Wide = [__m256; 2];

        #[inline(always)]
        fn load(self, x: &Line) -> [__m256; 2] {
            cast(*x)
        }

        #[inline(always)]
        fn store(self, v: [__m256; 2]) -> Line {
            cast(v)
        }

        #[inline(always)]
        fn splat(self, x: f32) -> [__m256; 2] {
            [self.avx._mm256_set1_ps(x); 2]
        }

        #[inline(always)]
        fn add(self, a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] {
            [self.avx._mm256_add_ps(a[0], b[0]), self.avx._mm256_add_ps(a[1], b[1])]
        }

        #[inline(always)]
        fn sub(self, a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] {
            [self.avx._mm256_sub_ps(a[0], b[0]), self.avx._mm256_sub_ps(a[1], b[1])]
        }

        #[inline(always)]
        fn mul(self, a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] {
            [self.avx._mm256_mul_ps(a[0], b[0]), self.avx._mm256_mul_ps(a[1], b[1])]
        }

        #[inline(always)]
        fn mul_add(self, a: [__m256; 2], b: [__m256; 2], c: [__m256; 2]) -> [__m256; 2] {
            [self.fma._mm256_fmadd_ps(a[0], b[0], c[0]), self.fma._mm256_fmadd_ps(a[1], b[1], c[1])]
        }

        #[inline(always)]
        fn next(self, v: [__m256; 2]) -> [__m256; 2] {
            let places = cast([1u32, 2, 3, 4, 5, 6, 7, 0]);
            let turned = [self.avx2._mm256_permutevar8x32_ps(v[0], places), self.avx2._mm256_permutevar8x32_ps(v[1], places)];
            let zero = self.avx._mm256_setzero_ps();
            [self.avx._mm256_blend_ps::<0x80>(turned[0], turned[1]), self.avx._mm256_blend_ps::<0x80>(turned[1], zero)]
        }

        #[inline(always)]
        fn previous(self, v: [__m256; 2]) -> [__m256; 2] {
            let places = cast([7u32, 0, 1, 2, 3, 4, 5, 6]);
            let turned = [self.avx2._mm256_permutevar8x32_ps(v[0], places), self.avx2._mm256_permutevar8x32_ps(v[1], places)];
            let zero = self.avx._mm256_setzero_ps();
            [self.avx._mm256_blend_ps::<1>(turned[0], zero), self.avx._mm256_blend_ps::<1>(turned[1], turned[0])]
        }

        #[inline(always)]
        fn keep(self, v: [__m256; 2], bits: u16) -> [__m256; 2] {
            let all = self.avx._mm256_set1_epi32(i32::from(bits));
            let (low, high) = (cast([1u32, 2, 4, 8, 16, 32, 64, 128]), cast([256u32, 512, 1024, 2048, 4096, 8192, 16384, 32768]));
            let low = self.avx2._mm256_cmpeq_epi32(self.avx2._mm256_and_si256(all, low), low);
            let high = self.avx2._mm256_cmpeq_epi32(self.avx2._mm256_and_si256(all, high), high);
            [self.avx._mm256_and_ps(cast(low), v[0]), self.avx._mm256_and_ps(cast(high), v[1])]
        }

        #[inline(always)]
        fn sums(self, v: [[__m256; 2]; 4]) -> [f32; 4] {
            let [a, b, c, d] = [quarters(self, v[0]), quarters(self, v[1]), quarters(self, v[2]), quarters(self, v[3])];
            cast(self.sse3._mm_hadd_ps(self.sse3._mm_hadd_ps(a, b), self.sse3._mm_hadd_ps(c, d)))
        }

        #[inline(always)]
        fn join(self, pieces: [[f32; 4]; 4]) -> [__m256; 2] {
            [self.avx._mm256_set_m128(cast(pieces[1]), cast(pieces[0])), self.avx._mm256_set_m128(cast(pieces[3]), cast(pieces[2]))]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything that lanes can do to some numbers.
    struct All([Line; 4]);

    impl Job for All {
        type Output = Vec<f32>;

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) -> Vec<f32> {
            let [a, b, c, d] = self.0.map(|x| l.load(&x));
            let mut out = Vec::new();
            for v in [l.add(a, b), l.sub(a, b), l.mul(a, b), l.next(a), l.previous(a), l.keep(a, 0b1010_0110_0000_1101), l.splat(0.3)] {
                out.extend(l.store(v));
            }
            out.extend(l.sums([a, b, c, d]));
            out.extend(l.store(l.join([0, 4, 8, 12].map(|i| [self.0[0][i], self.0[0][i + 1], self.0[1][i + 2], self.0[1][i + 3]]))));
            // Whole numbers, so that it does not matter whether it is rounded once.
            let whole = self.0.map(|x| l.load(&x.map(f32::round)));
            out.extend(l.store(l.mul_add(whole[0], whole[1], whole[2])));
            out
        }
    }

    #[test]
    fn all_processors_come_to_the_same_bits() {
        let numbers: [Line; 4] = std::array::from_fn(|n| std::array::from_fn(|i| ((17 * n + i) * 7919 % 1013) as f32 / 77.0 - 6.0));
        let plain = All(numbers).run(Plain);
        assert_eq!(plain[48..51], numbers[0][1..4]);
        assert_eq!(plain[63], 0.0);
        assert_eq!(plain[64], 0.0);
        approx::assert_relative_eq!(plain[112], numbers[0].iter().sum::<f32>(), epsilon = 1e-4);
        assert_eq!(dispatch(All(numbers)), plain);
        #[cfg(target_arch = "x86_64")]
        if let Some(v) = pulp::x86::V3::try_new() {
            assert_eq!(pulp::Simd::vectorize(v, With { job: All(numbers), lanes: v }), plain);
        }
    }
}

//! Pair sums four neighbours at a time.
//!
//! Arithmetic on [`Lanes`] is that of `wide`, which compiles to whatever vector registers the build may assume. What passes a test is
//! packed together by shuffles of `safe_arch` where that is AVX2, else value by value.

#[cfg(target_feature = "avx2")]
use safe_arch::{
    cast_to_m128_from_m128i, cast_to_m128i_from_m128, m128i, m256i, shuffle_av_f32_all_m128,
    shuffle_av_i32_all_m256i,
};
use wide::{f64x4, u32x4};

/// Neighbours in a block.
pub const LANES: usize = 4;

/// A value of each neighbour of a block.
pub type Lanes = f64x4;

/// sum_d a_d b_d, lane by lane.
#[inline]
pub fn dot<const D: usize>(a: &[Lanes; D], b: &[Lanes; D]) -> Lanes {
    (1..D).fold(a[0] * b[0], |sum, d| a[d].mul_add(b[d], sum))
}

/// Writes those of the first `count` of a block whose squared distance is below `limit` and whose number is not `but` to the front
/// of `numbers` and `squares`, and returns how many they are.
#[inline]
pub fn keep_near(
    (number, square, count): (&[u32; LANES], Lanes, usize),
    (limit, but): (f64, u32),
    numbers: &mut [u32; LANES],
    squares: &mut [f64; LANES],
) -> usize {
    let near = square.simd_lt(Lanes::splat(limit)).to_bitmask();
    let same = u32x4::new(*number).simd_eq(u32x4::splat(but)).to_bitmask();
    let present = (1 << count.min(LANES)) - 1;
    let kept = near & !same & present;
    pack(kept as usize, (number, square), numbers, squares);
    kept.count_ones() as usize
}

/// Writes the lanes of the set `kept` to the front.
#[inline]
fn pack(
    kept: usize,
    (number, square): (&[u32; LANES], Lanes),
    numbers: &mut [u32; LANES],
    squares: &mut [f64; LANES],
) {
    #[cfg(target_feature = "avx2")]
    {
        let bits = m256i::from(square.to_array().map(f64::to_bits));
        let packed: [u64; LANES] = shuffle_av_i32_all_m256i(bits, m256i::from(DOUBLES[kept])).into();
        *squares = packed.map(f64::from_bits);
        let bits = cast_to_m128_from_m128i(m128i::from(*number));
        *numbers = cast_to_m128i_from_m128(shuffle_av_f32_all_m128(bits, m128i::from(NUMBERS[kept]))).into();
    }
    #[cfg(not(target_feature = "avx2"))]
    {
        let mut place = 0;
        for (lane, square) in square.to_array().into_iter().enumerate() {
            // Written in any case, to lie behind what is kept or be overwritten: a branch here is mispredicted too often.
            (numbers[place], squares[place]) = (number[lane], square);
            place = (place + (kept >> lane & 1)).min(LANES - 1);
        }
    }
}

/// For each set of lanes, its lanes in ascending order, each by the numbers of its `PARTS` words of four bytes.
#[cfg(target_feature = "avx2")]
const fn packing<const PARTS: usize, const N: usize>() -> [[u32; N]; 1 << LANES] {
    let mut table = [[0; N]; 1 << LANES];
    let mut set = 0;
    while set < table.len() {
        let (mut lane, mut place) = (0, 0);
        while lane < LANES {
            let mut part = 0;
            while set >> lane & 1 == 1 && part < PARTS {
                table[set][place] = (lane * PARTS + part) as u32;
                (place, part) = (place + 1, part + 1);
            }
            lane += 1;
        }
        set += 1;
    }
    table
}

#[cfg(target_feature = "avx2")]
static DOUBLES: [[u32; 2 * LANES]; 1 << LANES] = packing::<2, { 2 * LANES }>();
#[cfg(target_feature = "avx2")]
static NUMBERS: [[u32; LANES]; 1 << LANES] = packing::<1, LANES>();

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_set_of_lanes_is_kept_in_order() {
        for set in 0..1_usize << LANES {
            let square: [f64; LANES] =
                std::array::from_fn(|k| if set >> k & 1 == 1 { 0.1 * k as f64 } else { 2.0 + k as f64 });
            for (but, count) in (0..=LANES).flat_map(|but| (1..=LANES + 1).map(move |count| (but, count))) {
                let (mut numbers, mut squares) = ([9; LANES], [9.0; LANES]);
                let block = (&[0, 1, 2, 3], Lanes::new(square), count);
                let kept = keep_near(block, (1.0, but as u32), &mut numbers, &mut squares);
                let is_kept = |k: &usize| set >> k & 1 == 1 && *k != but && *k < count;
                let expected: Vec<usize> = (0..LANES).filter(is_kept).collect();
                assert_eq!(kept, expected.len());
                for (k, (number, found)) in expected.into_iter().zip(numbers.into_iter().zip(squares)) {
                    assert_eq!((number, found), (k as u32, square[k]));
                }
            }
        }
        let (mut numbers, mut squares) = ([9; LANES], [9.0; LANES]);
        let strange = (&[4, 5, 6, 7], Lanes::new([f64::NAN, f64::INFINITY, 1.0, 0.5]), LANES);
        let kept = keep_near(strange, (1.0, 0), &mut numbers, &mut squares);
        assert_eq!((kept, numbers[0], squares[0]), (1, 7, 0.5), "below, not at the limit");
    }
}

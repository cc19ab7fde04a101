//! The sweep: blocks of cells, sampled and marched in parallel, joined by lattice keys.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::{Lattice, PolygonizeError, PolygonizeSummary};
use crate::geometry::Point;
use crate::implicit::Implicit;
use crate::mesh::TriMesh;

/// Cells of a block along an axis.
const SIDE: usize = 8;
const CELLS: usize = SIDE * SIDE * SIDE;
const CORNERS: usize = (SIDE + 1) * (SIDE + 1) * (SIDE + 1);

/// The six tetrahedra of a cell as corner numbers (bit a set: upper end of axis a), and whether each is
/// right-handed. They are the monotone paths from corner 0 to corner 7, so every edge leads from a corner to
/// one whose bits contain it: an edge is known by its lower corner and the difference of the bits.
const TETS: [([u8; 4], bool); 6] = [
    ([0, 1, 3, 7], true),
    ([0, 2, 6, 7], true),
    ([0, 4, 5, 7], true),
    ([0, 2, 3, 7], false),
    ([0, 4, 6, 7], false),
    ([0, 1, 5, 7], false),
];

/// Values nearer to zero than this part of a cell count as inside.
const SNAP: f64 = 1e-9;
/// No vertex comes nearer to a corner than this part of its edge.
const CLEARANCE: f64 = 1e-3;
/// A root is found when the function is this part of a cell away from zero.
const ROOT: f64 = 5e-5;

struct Block {
    wanted: [bool; CELLS],
    done: [bool; CELLS],
    dirty: bool,
    /// Values at the corners; not a number where not needed yet.
    values: Vec<f64>,
    evaluations: usize,
    /// After the sweep: per cell, number of the block's first vertex owned by it, and the mask of its edges.
    first: Vec<(u16, u8)>,
    points: Vec<Point>,
}

impl Block {
    fn new() -> Block {
        Block {
            wanted: [false; CELLS],
            done: [false; CELLS],
            dirty: true,
            values: vec![f64::NAN; CORNERS],
            evaluations: 0,
            first: Vec::new(),
            points: Vec::new(),
        }
    }

    fn corner_values(&self, cell: usize) -> [f64; 8] {
        let [i, j, k] = local(cell);
        std::array::from_fn(|c| self.values[corner_slot(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))])
    }
}

fn local(cell: usize) -> [usize; 3] {
    [cell % SIDE, cell / SIDE % SIDE, cell / (SIDE * SIDE)]
}

fn corner_slot(i: usize, j: usize, k: usize) -> usize {
    i + (SIDE + 1) * (j + (SIDE + 1) * k)
}

/// Block and place in the block of a cell.
fn address(cell: [i32; 3]) -> ([i32; 3], usize) {
    let s = SIDE as i32;
    let l = cell.map(|c| c.rem_euclid(s) as usize);
    (cell.map(|c| c.div_euclid(s)), l[0] + SIDE * (l[1] + SIDE * l[2]))
}

fn global(key: &[i32; 3], cell: usize) -> [i32; 3] {
    let l = local(cell);
    std::array::from_fn(|a| key[a] * SIDE as i32 + l[a] as i32)
}

/// Corners of each face of a cell, and the step over it.
const FACES: [([usize; 4], [i32; 3]); 6] = [
    ([0, 2, 4, 6], [-1, 0, 0]),
    ([1, 3, 5, 7], [1, 0, 0]),
    ([0, 1, 4, 5], [0, -1, 0]),
    ([2, 3, 6, 7], [0, 1, 0]),
    ([0, 1, 2, 3], [0, 0, -1]),
    ([4, 5, 6, 7], [0, 0, 1]),
];

struct Field<'a> {
    implicit: &'a dyn Implicit,
    lattice: &'a Lattice,
    level: f64,
}

impl Field<'_> {
    fn at(&self, p: &Point) -> f64 {
        self.implicit.value(p) - self.level
    }

    /// The root between corners `a` (value `fa`) and `b`: regula falsi, Illinois variant, after one step of inverse
    /// quadratic interpolation, which mostly suffices.
    fn root(&self, a: Point, b: Point, fa: f64, fb: f64) -> (Point, usize) {
        let tolerance = ROOT * self.lattice.cell();
        let ([mut lo, mut hi], [mut flo, mut fhi]) = ([0.0, 1.0], [fa, fb]);
        let mut t = fa / (fa - fb);
        let mut evaluations = 0;
        let mut last = 0i8;
        for round in 0..12 {
            let f = self.at(&(a + (b - a) * t));
            evaluations += 1;
            if f.abs() <= tolerance || !f.is_finite() {
                break;
            }
            if (f > 0.0) == (fhi > 0.0) {
                (hi, fhi) = (t, f);
                if last == 1 {
                    flo *= 0.5;
                }
                last = 1;
            } else {
                (lo, flo) = (t, f);
                if last == -1 {
                    fhi *= 0.5;
                }
                last = -1;
            }
            let width = hi - lo;
            let mut s = lo + width * (flo / (flo - fhi));
            if round == 0 {
                let [x, y, z] = [(0.0, fa), (1.0, fb), (t, f)];
                let term = |p: (f64, f64), q: (f64, f64), r: (f64, f64)| p.0 * (q.1 * r.1) / ((p.1 - q.1) * (p.1 - r.1));
                s = term(x, y, z) + term(y, x, z) + term(z, x, y);
            }
            // A jump of the function leaves a sliver that falsi cannot shrink: bisect then.
            t = if s > lo && s < hi { s } else { lo + 0.5 * width };
            if width < 1e-6 {
                break;
            }
        }
        (a + (b - a) * t.clamp(CLEARANCE, 1.0 - CLEARANCE), evaluations)
    }
}

/// Marches from `seeds` (cells) over all cells the level set passes through.
pub(super) fn sweep(
    implicit: &dyn Implicit,
    lattice: &Lattice,
    seeds: Vec<[i32; 3]>,
    level: f64,
) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    let field = Field { implicit, lattice, level };
    let mut blocks: BTreeMap<[i32; 3], Block> = BTreeMap::new();
    want(&mut blocks, seeds);
    let slack = (1.0 + SIDE as f64) * 2.0 * lattice.cell() + level.abs();
    let bounds = implicit.bounds().inflated(slack);
    loop {
        let found: Vec<Result<Vec<[i32; 3]>, PolygonizeError>> = blocks
            .iter_mut()
            .filter(|(_, b)| b.dirty)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(key, block)| follow(&field, key, block))
            .collect();
        let mut next = Vec::new();
        for cells in found {
            next.extend(cells?);
        }
        if next.is_empty() {
            break;
        }
        if let Some(&c) = next.iter().find(|&&c| bounds.squared_distance(&lattice.corner(c)) > 0.0) {
            return Err(PolygonizeError::LeavesBounds { at: lattice.corner(c).into() });
        }
        want(&mut blocks, next);
    }
    join(&field, blocks)
}

/// Marks cells as wanted and their blocks as dirty.
fn want(blocks: &mut BTreeMap<[i32; 3], Block>, cells: Vec<[i32; 3]>) {
    for c in cells {
        let (key, slot) = address(c);
        let block = blocks.entry(key).or_insert_with(Block::new);
        if !block.wanted[slot] {
            block.wanted[slot] = true;
            block.dirty = true;
        }
    }
}

/// Samples the wanted cells of a block, follows the surface inside it, and returns the cells it enters elsewhere.
fn follow(field: &Field, key: &[i32; 3], block: &mut Block) -> Result<Vec<[i32; 3]>, PolygonizeError> {
    let mut out = Vec::new();
    let mut stack: Vec<usize> = (0..CELLS).filter(|&c| block.wanted[c] && !block.done[c]).collect();
    let snap = SNAP * field.lattice.cell();
    while let Some(cell) = stack.pop() {
        if std::mem::replace(&mut block.done[cell], true) {
            continue;
        }
        let [i, j, k] = local(cell);
        let low = global(key, cell);
        let mut inside = [false; 8];
        for (c, inside) in inside.iter_mut().enumerate() {
            let (di, dj, dk) = (c & 1, c >> 1 & 1, c >> 2);
            let slot = corner_slot(i + di, j + dj, k + dk);
            if block.values[slot].is_nan() {
                let p = field.lattice.corner([low[0] + di as i32, low[1] + dj as i32, low[2] + dk as i32]);
                let v = field.at(&p);
                if !v.is_finite() {
                    return Err(PolygonizeError::NotFinite { value: v, at: p.into() });
                }
                block.values[slot] = if v.abs() < snap { -snap } else { v };
                block.evaluations += 1;
            }
            *inside = block.values[slot] < 0.0;
        }
        for (corners, step) in &FACES {
            let n = corners.iter().filter(|&&c| inside[c]).count();
            if n == 0 || n == 4 {
                continue;
            }
            let neighbour = std::array::from_fn(|a| low[a] + step[a]);
            let (other, slot) = address(neighbour);
            if other != *key {
                out.push(neighbour);
            } else if !block.done[slot] {
                block.wanted[slot] = true;
                stack.push(slot);
            }
        }
    }
    block.dirty = false;
    Ok(out)
}

/// Places the vertices of every block, numbers them in the order of the blocks, and makes the triangles.
fn join(field: &Field, mut blocks: BTreeMap<[i32; 3], Block>) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    blocks.iter_mut().collect::<Vec<_>>().into_par_iter().for_each(|(key, block)| place(field, key, block));
    let mut base = BTreeMap::new();
    let mut total = 0usize;
    for (key, block) in &blocks {
        base.insert(*key, total);
        total += block.points.len();
    }
    let cells: usize = blocks.values().map(|b| b.done.iter().filter(|&&d| d).count()).sum();
    let evaluations = blocks.values().map(|b| b.evaluations).sum();
    if total == 0 {
        return Err(PolygonizeError::NoSurface { cells, cell: field.lattice.cell() });
    }
    if total > u32::MAX as usize / 4 {
        return Err(PolygonizeError::TooLarge(total));
    }
    let points: Vec<Point> = blocks.values().flat_map(|b| b.points.iter().copied()).collect();
    let parts: Vec<Vec<[u32; 3]>> =
        blocks.par_iter().map(|(key, block)| triangles(field, &blocks, &base, &points, key, block)).collect();
    let mesh = TriMesh::new(points, parts.concat());
    let summary = PolygonizeSummary {
        cell: field.lattice.cell(),
        level: field.level,
        cells,
        evaluations,
        vertices: mesh.points.len(),
        triangles: mesh.triangles.len(),
    };
    Ok((mesh, summary))
}

/// The vertices on the seven edges that start at the lowest corner of each cell.
fn place(field: &Field, key: &[i32; 3], block: &mut Block) {
    block.first = vec![(0, 0); CELLS];
    for cell in (0..CELLS).filter(|&c| block.done[c]).collect::<Vec<_>>() {
        let v = block.corner_values(cell);
        block.first[cell].0 = block.points.len() as u16;
        let low = global(key, cell);
        for c in (1..8).filter(|&c| (v[0] < 0.0) != (v[c] < 0.0)) {
            let high = [low[0] + (c & 1) as i32, low[1] + (c >> 1 & 1) as i32, low[2] + (c >> 2) as i32];
            let (p, n) = field.root(field.lattice.corner(low), field.lattice.corner(high), v[0], v[c]);
            block.first[cell].1 |= 1 << c;
            block.evaluations += n;
            block.points.push(p);
        }
    }
}

fn triangles(
    field: &Field,
    blocks: &BTreeMap<[i32; 3], Block>,
    base: &BTreeMap<[i32; 3], usize>,
    points: &[Point],
    key: &[i32; 3],
    block: &Block,
) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    let here = base[key];
    // The vertex on the edge between two corners of a cell.
    let vertex = |low: &[i32; 3], a: u8, b: u8| -> u32 {
        let (a, b) = (a.min(b), a.max(b));
        let start = std::array::from_fn(|x| low[x] + (a >> x & 1) as i32);
        let (other, slot) = address(start);
        let (owner, first) = if other == *key { (block, here) } else { (&blocks[&other], base[&other]) };
        let (n, edges) = owner.first[slot];
        let before = (edges & ((1u8 << (a ^ b)) - 1)).count_ones();
        (first + n as usize) as u32 + before
    };
    let flipped = field.lattice.is_left_handed();
    for cell in (0..CELLS).filter(|&c| block.done[c]) {
        let v = block.corner_values(cell);
        let n = v.iter().filter(|&&x| x < 0.0).count();
        if n == 0 || n == 8 {
            continue;
        }
        let low = global(key, cell);
        for (tet, right_handed) in &TETS {
            let mut order = [0u8; 4];
            let mut negative = 0;
            for &c in tet.iter().filter(|&&c| v[c as usize] < 0.0) {
                order[negative] = c;
                negative += 1;
            }
            let mut at = negative;
            for &c in tet.iter().filter(|&&c| v[c as usize] >= 0.0) {
                order[at] = c;
                at += 1;
            }
            // Corners of a tetrahedron are listed in rising order: inversions tell the parity.
            let inversions = (0..4).flat_map(|x| (x + 1..4).map(move |y| (x, y))).filter(|&(x, y)| order[x] > order[y]).count();
            let even = (inversions % 2 == 0) == *right_handed;
            let [a, b, c, d] = order;
            let mut push = |t: [u32; 3]| out.push(if even != flipped { t } else { [t[0], t[2], t[1]] });
            match negative {
                1 => push([vertex(&low, a, b), vertex(&low, a, c), vertex(&low, a, d)]),
                3 => push([vertex(&low, a, d), vertex(&low, b, d), vertex(&low, c, d)]),
                2 => {
                    let q = [vertex(&low, a, c), vertex(&low, a, d), vertex(&low, b, d), vertex(&low, b, c)];
                    let length = |x: u32, y: u32| (points[x as usize] - points[y as usize]).norm_squared();
                    if length(q[0], q[2]) <= length(q[1], q[3]) {
                        push([q[0], q[1], q[2]]);
                        push([q[0], q[2], q[3]]);
                    } else {
                        push([q[0], q[1], q[3]]);
                        push([q[1], q[2], q[3]]);
                    }
                }
                _ => {}
            }
        }
    }
    out
}

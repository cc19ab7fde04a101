//! The sweep: blocks of cells, sampled and marched in parallel, joined by lattice keys.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::roots::{self, Edge};
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
struct Block {
    wanted: [bool; CELLS],
    done: [bool; CELLS],
    dirty: bool,
    /// Values at the corners; not a number where not needed yet.
    values: Vec<f64>,
    /// Whether the function was sampled at all corners at once: it is smooth then.
    sampled: bool,
    /// Per cell done, its corners inside, a bit each.
    inside: [u8; CELLS],
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
            sampled: false,
            inside: [0; CELLS],
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

/// Places of a cell's corners from its lowest one on.
const STEPS: [usize; 8] = {
    let (y, z) = (SIDE + 1, (SIDE + 1) * (SIDE + 1));
    [0, 1, y, y + 1, z, z + 1, z + y, z + y + 1]
};

/// Corners of each face of a cell as bits, the axis across it and whether it lies at the upper end.
const FACES: [(u8, usize, bool); 6] = [
    (0b0101_0101, 0, false),
    (0b1010_1010, 0, true),
    (0b0011_0011, 1, false),
    (0b1100_1100, 1, true),
    (0b0000_1111, 2, false),
    (0b1111_0000, 2, true),
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

    /// Values at all corners of a block, where the function has a fast way.
    fn sample(&self, key: &[i32; 3], values: &mut [f64]) -> bool {
        let (origin, steps) = self.lattice.frame();
        let found = self.implicit.values_on(origin, steps, key.map(|k| k * SIDE as i32), SIDE + 1, values);
        if found {
            values.iter_mut().for_each(|v| *v -= self.level);
        }
        found
    }
}

/// The blocks, as they were first met, and their order in space.
#[derive(Default)]
struct Blocks {
    index: BTreeMap<[i32; 3], usize>,
    list: Vec<([i32; 3], Box<Block>)>,
}

impl Blocks {
    /// Marks cells as wanted and their blocks as dirty.
    fn want(&mut self, cells: impl Iterator<Item = [i32; 3]>) {
        let mut last = None;
        for c in cells {
            let (key, slot) = address(c);
            let n = match last {
                Some((k, n)) if k == key => n,
                _ => *self.index.entry(key).or_insert_with(|| {
                    self.list.push((key, Box::new(Block::new())));
                    self.list.len() - 1
                }),
            };
            last = Some((key, n));
            let block = &mut self.list[n].1;
            if !block.wanted[slot] {
                block.wanted[slot] = true;
                block.dirty = true;
            }
        }
    }
}

/// Marches from `seeds` (cells) over all cells the level set passes through.
pub(super) fn sweep(
    implicit: &dyn Implicit,
    lattice: &Lattice,
    seeds: impl Iterator<Item = [i32; 3]>,
    level: f64,
) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    let field = Field { implicit, lattice, level };
    let mut blocks = Blocks::default();
    blocks.want(seeds);

    let slack = (1.0 + SIDE as f64) * 2.0 * lattice.longest() + level.abs();
    let bounds = implicit.bounds().inflated(slack);
    loop {
        let found: Vec<Result<Vec<[i32; 3]>, PolygonizeError>> = blocks
            .list
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
        blocks.want(next.into_iter());
    }
    join(&field, blocks)
}

/// Samples the wanted cells of a block, follows the surface inside it, and returns the cells it enters elsewhere.
fn follow(field: &Field, key: &[i32; 3], block: &mut Block) -> Result<Vec<[i32; 3]>, PolygonizeError> {
    let mut out = Vec::new();
    let mut stack: Vec<usize> = (0..CELLS).filter(|&c| block.wanted[c] && !block.done[c]).collect();
    let snap = SNAP * field.lattice.cell();
    if block.evaluations == 0 && field.sample(key, &mut block.values) {
        block.values.iter_mut().filter(|v| v.abs() < snap).for_each(|v| *v = -snap);
        block.evaluations = CORNERS;
        block.sampled = true;
    }
    while let Some(cell) = stack.pop() {
        if std::mem::replace(&mut block.done[cell], true) {
            continue;
        }
        let at = local(cell);
        let low = corner_slot(at[0], at[1], at[2]);
        let mut inside = 0u8;
        for (c, step) in STEPS.iter().enumerate() {
            let v = &mut block.values[low + step];
            if v.is_nan() {
                let [i, j, k] = global(key, cell);
                let p = field.lattice.corner([i + (c & 1) as i32, j + (c >> 1 & 1) as i32, k + (c >> 2) as i32]);
                *v = field.at(&p);
                if !v.is_finite() {
                    return Err(PolygonizeError::NotFinite { value: *v, at: p.into() });
                }
                if v.abs() < snap {
                    *v = -snap;
                }
                block.evaluations += 1;
            }
            inside |= u8::from(*v < 0.0) << c;
        }
        block.inside[cell] = inside;
        if inside == 0 || inside == u8::MAX {
            continue;
        }
        for (face, axis, up) in FACES {
            if inside & face == 0 || inside & face == face {
                continue;
            }
            let mut next = at;
            if if up { at[axis] + 1 < SIDE } else { at[axis] > 0 } {
                next[axis] = if up { at[axis] + 1 } else { at[axis] - 1 };
                let slot = next[0] + SIDE * (next[1] + SIDE * next[2]);
                if !block.done[slot] {
                    block.wanted[slot] = true;
                    stack.push(slot);
                }
            } else {
                let mut neighbour = global(key, cell);
                neighbour[axis] += if up { 1 } else { -1 };
                out.push(neighbour);
            }
        }
    }
    block.dirty = false;
    Ok(out)
}

/// Places the vertices of every block, numbers them in the order of the blocks, and makes the triangles.
fn join(field: &Field, blocks: Blocks) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    let Blocks { mut list, mut index } = blocks;
    list.sort_unstable_by_key(|(key, _)| *key);
    index.values_mut().enumerate().for_each(|(n, place)| *place = n);
    list.par_iter_mut().for_each(|(key, block)| {
        place(field, key, block);
        // Half of a block's memory, which the vertices of the next ones can have.
        block.values = Vec::new();
    });

    let mut base = Vec::with_capacity(list.len());
    let mut total = 0usize;
    for (_, block) in &list {
        base.push(total as u32);
        total += block.points.len();
    }
    let cells: usize = list.iter().map(|(_, b)| b.done.iter().filter(|&&d| d).count()).sum();
    let evaluations = list.iter().map(|(_, b)| b.evaluations).sum();
    if total == 0 {
        return Err(PolygonizeError::NoSurface { cells, cell: field.lattice.cell() });
    }
    if total > u32::MAX as usize / 4 {
        return Err(PolygonizeError::TooLarge(total));
    }
    let mut points = Vec::with_capacity(total);
    list.iter_mut().for_each(|(_, b)| points.extend(std::mem::take(&mut b.points)));
    let cases = cases();
    // Triangles of a cell by its corners inside, so that every block knows its place in the list.
    let per_cell: [usize; 256] = std::array::from_fn(|inside| {
        let of = |(tet, cases): (&([u8; 4], bool), &[TetCase; 16])| usize::from(cases[signs(tet.0, inside)].len.saturating_sub(2));
        TETS.iter().zip(&cases).map(of).sum()
    });
    let counts: Vec<usize> = list.iter().map(|(_, b)| b.inside.iter().map(|&i| per_cell[usize::from(i)]).sum()).collect();
    let mut all = vec![[0u32; 3]; counts.iter().sum()];
    let mut rest = &mut all[..];
    let mut parts = Vec::with_capacity(list.len());
    for ((key, block), n) in list.iter().zip(counts) {
        let (part, tail) = std::mem::take(&mut rest).split_at_mut(n);
        rest = tail;
        parts.push((key, block, part));
    }
    parts.into_par_iter().for_each(|(key, block, part)| {
        // Blocks of the seven neighbours that own some of this one's vertices.
        let near = std::array::from_fn(|n| {
            let other = std::array::from_fn(|a| key[a] + (n >> a & 1) as i32);
            index.get(&other).map(|&n| Owner { first: base[n], cells: &list[n].1.first })
        });
        triangles(field.lattice.is_left_handed(), &cases, &near, &points, block, part);
    });
    let mesh = TriMesh::new(points, all);
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
    let mut edges = Vec::new();
    for cell in (0..CELLS).filter(|&c| block.done[c]) {
        block.first[cell].0 = edges.len() as u16;
        if block.inside[cell] == 0 || block.inside[cell] == u8::MAX {
            continue;
        }
        let v = block.corner_values(cell);
        let at = local(cell);
        let low = global(key, cell);
        let corner = field.lattice.corner(low);
        for c in (1..8).filter(|&c| (v[0] < 0.0) != (v[c] < 0.0)) {
            let step = [c & 1, c >> 1 & 1, c >> 2];
            // The value some steps along the edge's line, where the block surely has it: which corners of others are known
            // depends on where the march began.
            let along = |n: i64| {
                let at: [i64; 3] = std::array::from_fn(|a| at[a] as i64 + n * step[a] as i64);
                let inside = block.sampled && at.iter().all(|x| (0..=SIDE as i64).contains(x));
                if inside { block.values[corner_slot(at[0] as usize, at[1] as usize, at[2] as usize)] } else { f64::NAN }
            };
            let high = field.lattice.corner([0, 1, 2].map(|a| low[a] + step[a] as i32));
            edges.push(Edge::new([corner, high], [v[0], v[c]], [along(-1), along(2)]));
            block.first[cell].1 |= 1 << c;
        }
    }
    let values = |points: &[Point], out: &mut [f64]| {
        field.implicit.values(points, out);
        out.iter_mut().for_each(|v| *v -= field.level);
    };
    block.evaluations += roots::find(&mut edges, field.lattice.cell(), block.sampled, values);
    block.points = edges.iter().map(Edge::root).collect();
}

/// The vertices that belong to a block: number of its first one and, per cell, of the cell's first and the mask of edges.
struct Owner<'a> {
    first: u32,
    cells: &'a [(u16, u8)],
}

/// What to put in a tetrahedron of some signs: corner pairs of the edges with a vertex, three of them or four in a ring.
#[derive(Clone, Copy, Default)]
struct TetCase {
    edges: [(u8, u8); 4],
    len: u8,
    /// Whether the ring turns the other way.
    turned: bool,
}

/// By tetrahedron and by the signs of its corners, bit n set where the n-th is inside.
fn cases() -> [[TetCase; 16]; 6] {
    TETS.map(|(tet, right_handed)| {
        std::array::from_fn(|signs| {
            let mut order: Vec<u8> = (0..4).filter(|n| signs >> n & 1 == 1).map(|n| tet[n]).collect();
            let negative = order.len();
            order.extend((0..4).filter(|n| signs >> n & 1 == 0).map(|n| tet[n]));
            // Corners of a tetrahedron are listed in rising order: inversions tell the parity.
            let inversions = (0..4).flat_map(|x| (x + 1..4).map(move |y| (x, y))).filter(|&(x, y)| order[x] > order[y]).count();
            let [a, b, c, d] = [order[0], order[1], order[2], order[3]];
            let (edges, len) = match negative {
                1 => ([(a, b), (a, c), (a, d), (0, 0)], 3),
                3 => ([(a, d), (b, d), (c, d), (0, 0)], 3),
                2 => ([(a, c), (a, d), (b, d), (b, c)], 4),
                _ => ([(0, 0); 4], 0),
            };
            let edges = edges.map(|(a, b): (u8, u8)| (a.min(b), a.max(b)));
            TetCase { edges, len, turned: (inversions % 2 == 0) != right_handed }
        })
    })
}

/// The corners of a tetrahedron that are inside, a bit each, of those of its cell.
#[inline]
fn signs(tet: [u8; 4], inside: usize) -> usize {
    (0..4).fold(0, |s, n| s | (inside >> tet[n] & 1) << n)
}

fn triangles(left_handed: bool, cases: &[[TetCase; 16]; 6], near: &[Option<Owner>; 8], points: &[Point], block: &Block, out: &mut [[u32; 3]]) {
    let mut out = out.iter_mut();
    // The vertex on the edge between two corners of a cell, `a` the lower one; its owner exists, as `follow` made it.
    let vertex = |low: [usize; 3], (a, b): (u8, u8)| -> u32 {
        let at: [usize; 3] = std::array::from_fn(|x| low[x] + usize::from(a >> x & 1));
        let owner = at[0] / SIDE + 2 * (at[1] / SIDE) + 4 * (at[2] / SIDE);
        let slot = at[0] % SIDE + SIDE * (at[1] % SIDE + SIDE * (at[2] % SIDE));
        near[owner].as_ref().map_or(u32::MAX, |o| {
            let (n, edges) = o.cells[slot];
            o.first + u32::from(n) + (edges & ((1u8 << (a ^ b)) - 1)).count_ones()
        })
    };
    for cell in (0..CELLS).filter(|&c| block.done[c]) {
        let inside = usize::from(block.inside[cell]);
        if inside == 0 || inside == usize::from(u8::MAX) {
            continue;
        }
        let low = local(cell);
        for ((tet, _), cases) in TETS.iter().zip(cases) {
            let case = &cases[signs(*tet, inside)];
            let mut push = |t: [u32; 3]| {
                if let Some(to) = out.next() {
                    *to = if case.turned == left_handed { t } else { [t[0], t[2], t[1]] };
                }
            };
            match case.len {
                3 => push([0, 1, 2].map(|n| vertex(low, case.edges[n]))),
                4 => {
                    let q = case.edges.map(|e| vertex(low, e));
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
}

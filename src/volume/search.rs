//! Where a better place for a vertex is looked for.

const D: f64 = 0.577_350_269_189_625_8;

/// Unit vectors along the axes and the diagonals of a cube.
pub(super) const DIRECTIONS: [[f64; 3]; 14] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [D, D, D],
    [-D, -D, -D],
    [D, D, -D],
    [-D, -D, D],
    [D, -D, D],
    [-D, D, -D],
    [-D, D, D],
    [D, -D, -D],
];

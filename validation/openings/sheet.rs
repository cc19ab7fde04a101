//! A contact sheet of samples with their true ends and the openings found.

use std::f64::consts::TAU;
use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use lumenmesh::geometry::{Plane, Point, Vector};
use lumenmesh::mask::Mask;
use lumenmesh::phantom::Sample;

use super::judge::Judged;

const SIZE: usize = 240;
const COLUMNS: usize = 8;

type Rgb = [u8; 3];
const WHITE: Rgb = [255; 3];
const FAULT: Rgb = [220, 40, 40];
const TRUTH: Rgb = [0, 150, 60];
const INLET: Rgb = [230, 20, 20];
const OUTLET: Rgb = [20, 60, 230];

/// The digits as rows of three pixels.
const DIGITS: [[u8; 5]; 10] = [
    [7, 5, 5, 5, 7],
    [2, 6, 2, 2, 7],
    [7, 1, 7, 4, 7],
    [7, 1, 7, 1, 7],
    [5, 5, 7, 1, 1],
    [7, 4, 7, 1, 7],
    [7, 4, 7, 5, 7],
    [7, 1, 1, 1, 1],
    [7, 5, 7, 5, 7],
    [7, 5, 7, 1, 7],
];

/// One sample, drawn.
pub struct Tile(Vec<Rgb>);

struct View {
    right: Vector,
    up: Vector,
    ahead: Vector,
    center: Point,
    scale: f64,
}

impl View {
    /// The direction in which the vessel is thinnest lies ahead, turned a little.
    fn new(points: &[Point]) -> View {
        let mean = points.iter().fold(Vector::zeros(), |s, p| s + p.coords) / points.len().max(1) as f64;
        let spread = points.iter().fold(nalgebra::Matrix3::zeros(), |s, p| {
            let d = p.coords - mean;
            s + d * d.transpose()
        });
        let eigen = nalgebra::SymmetricEigen::new(spread);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let axis = |n: usize| eigen.eigenvectors.column(order[n]).into_owned();
        let up = axis(0);
        let ahead = (axis(2) + axis(1) * 0.35 + up * 0.25).normalize();
        let right = ahead.cross(&up).normalize();
        let up = right.cross(&ahead);
        let reach = |d: &Vector| points.iter().map(|p| (p.coords - mean).dot(d)).fold((0.0f64, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
        let ((a, b), (c, d)) = (reach(&right), reach(&up));
        let center = Point::from(mean + right * (0.5 * (a + b)) + up * (0.5 * (c + d)));
        View { right, up, ahead, center, scale: 0.86 * SIZE as f64 / (b - a).max(d - c).max(1e-9) }
    }

    fn at(&self, p: &Point) -> [f64; 3] {
        let d = p - self.center;
        let half = SIZE as f64 / 2.0;
        [half + self.scale * d.dot(&self.right), half - self.scale * d.dot(&self.up), d.dot(&self.ahead)]
    }
}

/// Voxels at the boundary with the direction out of the vessel.
fn boundary(mask: &Mask) -> Vec<(Point, Vector)> {
    let mut out = Vec::new();
    for n in (0..mask.data.len()).filter(|&n| mask.data[n] != 0) {
        let [i, j, k] = mask.grid.voxel(n).map(|c| c as i64);
        if [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)].iter().all(|d| mask.at(i + d.0, j + d.1, k + d.2)) {
            continue;
        }
        let mut g = Vector::zeros();
        for (a, b, c) in (-2..=2).flat_map(|a| (-2..=2).flat_map(move |b| (-2..=2).map(move |c| (a, b, c)))) {
            if !mask.at(i + a, j + b, k + c) {
                g += mask.grid.axes * Vector::new(a as f64, b as f64, c as f64);
            }
        }
        let p = mask.grid.to_world(Vector::new(i as f64, j as f64, k as f64));
        out.push((p, g.try_normalize(1e-9).unwrap_or_else(Vector::x)));
    }
    out
}

impl Tile {
    pub fn new(sample: &Sample, judged: &Judged) -> Tile {
        let shell = boundary(&sample.mask);
        let points: Vec<Point> = shell.iter().map(|s| s.0).collect();
        let view = View::new(&points);
        let mut pixels = vec![WHITE; SIZE * SIZE];
        let mut depth = vec![f64::INFINITY; SIZE * SIZE];
        let half = (0.75 * view.scale * sample.mask.grid.voxel_diagonal()).max(0.5).ceil() as i64;
        for (p, n) in &shell {
            let [x, y, z] = view.at(p);
            let light = (0.35 - 0.65 * n.dot(&view.ahead)).clamp(0.15, 1.0);
            let shade = [light * 235.0, light * 205.0, light * 190.0].map(|c| c as u8);
            for (dx, dy) in (-half..=half).flat_map(|a| (-half..=half).map(move |b| (a, b))) {
                let (x, y) = (x as i64 + dx, y as i64 + dy);
                if (0..SIZE as i64).contains(&x) && (0..SIZE as i64).contains(&y) {
                    let at = y as usize * SIZE + x as usize;
                    if z < depth[at] {
                        (depth[at], pixels[at]) = (z, shade);
                    }
                }
            }
        }
        for e in &sample.ends {
            ring(&mut pixels, &view, &e.plane, (e.cap_area / std::f64::consts::PI).sqrt(), TRUTH, 1.5);
        }
        for o in &judged.run.found {
            let near = sample.ends.iter().map(|e| ((e.plane.origin - o.plane.origin).norm(), e.radius)).min_by(|a, b| a.0.total_cmp(&b.0));
            let radius = o.area.map_or(near.map_or(1.0, |n| n.1), |a| (a / std::f64::consts::PI).sqrt());
            ring(&mut pixels, &view, &o.plane, 0.85 * radius, if o.inlet { INLET } else { OUTLET }, 2.5);
        }
        if !judged.faults.is_empty() {
            for n in 0..SIZE {
                for w in 0..3 {
                    for at in [w * SIZE + n, (SIZE - 1 - w) * SIZE + n, n * SIZE + w, n * SIZE + SIZE - 1 - w] {
                        pixels[at] = FAULT;
                    }
                }
            }
        }
        let number = sample.name.rsplit('-').next().unwrap_or_default();
        for (n, digit) in number.bytes().filter(u8::is_ascii_digit).enumerate() {
            for (row, bits) in DIGITS[usize::from(digit - b'0')].iter().enumerate() {
                for (column, dy, dx) in (0..3).flat_map(|c| (0..3).flat_map(move |y| (0..3).map(move |x| (c, y, x)))) {
                    if bits >> (2 - column) & 1 == 1 {
                        pixels[(6 + 3 * row + dy) * SIZE + 6 + 12 * n + 3 * column + dx] = [60; 3];
                    }
                }
            }
        }
        Tile(pixels)
    }
}

/// A circle in a plane, with its normal.
fn ring(pixels: &mut [Rgb], view: &View, plane: &Plane, radius: f64, colour: Rgb, width: f64) {
    let (u, v) = plane.basis();
    let circle = (0..360).map(|n| {
        let (s, c) = (TAU * f64::from(n) / 360.0).sin_cos();
        plane.origin + (u * c + v * s) * radius
    });
    let arrow = (0..60).map(|n| plane.origin + plane.normal * (radius * f64::from(n) / 60.0));
    for p in circle.chain(arrow) {
        let [x, y, _] = view.at(&p);
        let reach = width.ceil() as i64;
        for (dx, dy) in (-reach..=reach).flat_map(|a| (-reach..=reach).map(move |b| (a, b))) {
            let (px, py) = (x as i64 + dx, y as i64 + dy);
            let close = (px as f64 + 0.5 - x).hypot(py as f64 + 0.5 - y) <= 0.5 * width + 0.3;
            if close && (0..SIZE as i64).contains(&px) && (0..SIZE as i64).contains(&py) {
                pixels[py as usize * SIZE + px as usize] = colour;
            }
        }
    }
}

/// The tiles in rows of eight, as PNG (ISO/IEC 15948) of 8-bit RGB.
pub fn png(tiles: &[Tile]) -> std::io::Result<Vec<u8>> {
    let columns = COLUMNS.min(tiles.len()).max(1);
    let (width, height) = (columns * SIZE, tiles.len().div_ceil(columns).max(1) * SIZE);
    let mut rows = Vec::with_capacity(height * (3 * width + 1));
    for y in 0..height {
        rows.push(0);
        for x in 0..width {
            let tile = tiles.get(y / SIZE * columns + x / SIZE);
            rows.extend(tile.map_or(WHITE, |t| t.0[y % SIZE * SIZE + x % SIZE]));
        }
    }
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::default());
    packed.write_all(&rows)?;
    let size = [(width as u32).to_be_bytes(), (height as u32).to_be_bytes()].concat();
    let chunks = [(b"IHDR", [size.as_slice(), &[8, 2, 0, 0, 0]].concat()), (b"IDAT", packed.finish()?), (b"IEND", Vec::new())];
    for (name, body) in chunks {
        out.extend((body.len() as u32).to_be_bytes());
        let start = out.len();
        out.extend(name);
        out.extend(body);
        let mut crc = flate2::Crc::new();
        crc.update(&out[start..]);
        out.extend(crc.sum().to_be_bytes());
    }
    Ok(out)
}

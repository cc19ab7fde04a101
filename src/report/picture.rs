//! Still pictures of a surface for those who print: a small z-buffer renderer and a PNG writer.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;

/// Colour of a triangle: red, green, blue from 0 to 1.
pub type Colour = [f64; 3];

fn pick(map: &[[f64; 3]], t: f64) -> Colour {
    // What is not a number takes the middle.
    let t = if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.5 };
    let x = t * (map.len() - 1) as f64;
    let i = (x as usize).min(map.len() - 2);
    [0, 1, 2].map(|k| (map[i][k] + (x - i as f64) * (map[i + 1][k] - map[i][k])) / 255.0)
}

/// Blue to white to orange at `t` from 0 to 1, for figures with a sign; readable by colour-blind people.
pub fn diverging(t: f64) -> Colour {
    const MAP: [[f64; 3]; 9] = [
        [33.0, 60.0, 129.0],
        [58.0, 110.0, 177.0],
        [122.0, 166.0, 210.0],
        [196.0, 217.0, 233.0],
        [247.0, 247.0, 247.0],
        [248.0, 214.0, 180.0],
        [238.0, 162.0, 100.0],
        [205.0, 104.0, 36.0],
        [128.0, 56.0, 8.0],
    ];
    pick(&MAP, t)
}

/// Viridis at `t` from 0 to 1: even to the eye, readable by colour-blind people and in grey.
pub fn viridis(t: f64) -> Colour {
    const MAP: [[f64; 3]; 10] = [
        [68.0, 1.0, 84.0],
        [72.0, 40.0, 120.0],
        [62.0, 74.0, 137.0],
        [49.0, 104.0, 142.0],
        [38.0, 130.0, 142.0],
        [31.0, 158.0, 137.0],
        [53.0, 183.0, 121.0],
        [109.0, 205.0, 89.0],
        [180.0, 222.0, 44.0],
        [253.0, 231.0, 37.0],
    ];
    pick(&MAP, t)
}

/// Colour of a patch.
pub fn patch_colour(id: u32) -> Colour {
    const COLOURS: [[u8; 3]; 9] = [
        [150, 160, 170],
        [0, 114, 178],
        [213, 94, 0],
        [0, 158, 115],
        [204, 121, 167],
        [230, 159, 0],
        [86, 180, 233],
        [240, 228, 66],
        [120, 94, 240],
    ];
    COLOURS[(id.saturating_sub(1) % 9) as usize].map(|c| f64::from(c) / 255.0)
}

/// Renders `mesh` seen along `direction` (z up where it can be) into a PNG of `width` × `height` pixels, white behind.
pub fn render(mesh: &TriMesh, direction: Vector, width: usize, height: usize, colour: impl Fn(usize) -> Colour) -> Vec<u8> {
    let view = direction.normalize();
    let up = if view.z.abs() > 0.95 { Vector::y() } else { Vector::z() };
    let right = view.cross(&up).normalize();
    let up = right.cross(&view);
    let bounds = mesh.bounds();
    let center = bounds.center();
    let flat = |p: &Point| {
        let d = p - center;
        [d.dot(&right), d.dot(&up), d.dot(&view)]
    };
    let points: Vec<[f64; 3]> = mesh.points.iter().map(flat).collect();
    let reach = |k: usize| points.iter().fold(1e-12f64, |m, p| m.max(p[k].abs()));
    let scale = 0.47 * (width as f64 / reach(0)).min(height as f64 / reach(1));
    let (w, h) = (2 * width, 2 * height);
    let pixel = |p: [f64; 3]| [w as f64 / 2.0 + 2.0 * scale * p[0], h as f64 / 2.0 - 2.0 * scale * p[1], p[2]];
    let mut depth = vec![f64::INFINITY; w * h];
    let mut image = vec![[1.0f64; 3]; w * h];
    let light = (-view + 0.4 * up - 0.3 * right).normalize();
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.triangles[t].map(|v| pixel(points[v as usize]));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0.0 {
            continue;
        }
        let normal = mesh.area_vector2(t).normalize();
        let shade = 0.35 + 0.65 * normal.dot(&light).max(0.0);
        let rgb = colour(t).map(|x| x * shade);
        let range = |k: usize, limit: usize| {
            let lo = a[k].min(b[k]).min(c[k]).floor().max(0.0) as usize;
            let hi = a[k].max(b[k]).max(c[k]).ceil().max(0.0) as usize;
            lo..hi.min(limit.saturating_sub(1)) + 1
        };
        for y in range(1, h) {
            for x in range(0, w) {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let u = ((b[0] - px) * (c[1] - py) - (b[1] - py) * (c[0] - px)) / area;
                let v = ((c[0] - px) * (a[1] - py) - (c[1] - py) * (a[0] - px)) / area;
                let z = u * a[2] + v * b[2] + (1.0 - u - v) * c[2];
                if x < w && y < h && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && z < depth[y * w + x] {
                    depth[y * w + x] = z;
                    image[y * w + x] = rgb;
                }
            }
        }
    }
    // Two by two samples a pixel.
    let mut bytes = Vec::with_capacity(height * (3 * width + 1));
    for y in 0..height {
        bytes.push(0);
        for x in 0..width {
            let at = |dx: usize, dy: usize| image[(2 * y + dy) * w + 2 * x + dx];
            for k in 0..3 {
                let mean = (at(0, 0)[k] + at(1, 0)[k] + at(0, 1)[k] + at(1, 1)[k]) / 4.0;
                bytes.push((mean.clamp(0.0, 1.0) * 255.0).round() as u8);
            }
        }
    }
    png(width, height, &bytes)
}

/// PNG (ISO/IEC 15948) of 8-bit RGB rows, each behind its filter byte 0.
fn png(width: usize, height: usize, rows: &[u8]) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut header = Vec::new();
    header.extend((width as u32).to_be_bytes());
    header.extend((height as u32).to_be_bytes());
    header.extend([8, 2, 0, 0, 0]);
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::default());
    // Writing to memory cannot fail; an empty stream would only make an empty picture.
    let data = packed.write_all(rows).and_then(|()| packed.finish()).unwrap_or_default();
    for (kind, body) in [(b"IHDR", header), (b"IDAT", data), (b"IEND", Vec::new())] {
        out.extend((body.len() as u32).to_be_bytes());
        let mut crc = flate2::Crc::new();
        crc.update(kind);
        crc.update(&body);
        out.extend(kind);
        out.extend(&body);
        out.extend(crc.sum().to_be_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_triangle_hides_the_farther_one() {
        let points = [0.0, 1.0].iter().flat_map(|&y| [[-1.0, y, -1.0], [1.0, y, -1.0], [0.0, y, 1.0]]).map(Point::from).collect();
        let mesh = TriMesh::new(points, vec![[3, 4, 5], [0, 1, 2]]);
        let near_first = render(&mesh, Vector::y(), 32, 32, |t| if t == 1 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] });
        let only_near = render(&TriMesh::new(mesh.points.clone(), vec![[0, 1, 2]]), Vector::y(), 32, 32, |_| [1.0, 0.0, 0.0]);
        assert_eq!(near_first, only_near);
        assert_eq!(&near_first[..8], b"\x89PNG\r\n\x1a\n");
    }
}

//! Closed, patched vessel surfaces with structured triangles, for tests of what comes after the surface.
#![allow(dead_code)]

use lumenmesh::geometry::{Point, Vector};
use lumenmesh::mesh::{Patch, PatchKind, TriMesh, WALL};

/// Patches wall, inlet, outlet_1.
pub fn patches() -> Vec<Patch> {
    vec![
        Patch::wall(),
        Patch { id: 2, name: "inlet".into(), kind: PatchKind::Inlet },
        Patch { id: 3, name: "outlet_1".into(), kind: PatchKind::Outlet },
    ]
}

/// A tube along `axis(s)` (position, unit tangent, unit normal), `s` from 0 to 1, of radius `radius(s)`, with
/// `6 k` edges round and `rings` rings of triangles; planar caps of concentric rings.
pub fn tube(
    k: usize,
    rings: usize,
    axis: impl Fn(f64) -> (Point, Vector, Vector),
    radius: impl Fn(f64) -> f64,
) -> TriMesh {
    let n = 6 * k;
    let mut m = TriMesh { patches: patches(), ..TriMesh::default() };
    let turn = |i: f64| 2.0 * std::f64::consts::PI * i / n as f64;
    let place = |s: f64, r: f64, phi: f64| {
        let (c, t, u) = axis(s);
        c + (u * phi.cos() + t.cross(&u) * phi.sin()) * r
    };
    for j in 0..=rings {
        let s = j as f64 / rings as f64;
        for i in 0..n {
            m.points.push(place(s, radius(s), turn(i as f64 + 0.5 * (j % 2) as f64)));
        }
    }
    let mut put = |t: [usize; 3], p: u32| {
        m.triangles.push(t.map(|v| v as u32));
        m.patch.push(p);
    };
    for j in 0..rings {
        let at = |j: usize, i: usize| j * n + i % n;
        for i in 0..n {
            if j % 2 == 0 {
                put([at(j, i), at(j, i + 1), at(j + 1, i)], WALL);
                put([at(j, i + 1), at(j + 1, i + 1), at(j + 1, i)], WALL);
            } else {
                put([at(j, i), at(j, i + 1), at(j + 1, i + 1)], WALL);
                put([at(j, i), at(j + 1, i + 1), at(j + 1, i)], WALL);
            }
        }
    }
    for (s, ring, patch) in [(0.0, 0, 2), (1.0, rings, 3)] {
        // Ring q of the cap holds 6 q points; the outermost is the rim.
        let mut starts = vec![0usize; k + 1];
        starts[k] = ring * n;
        let phase = 0.5 * (ring % 2) as f64;
        for q in (0..k).rev() {
            starts[q] = m.points.len();
            for i in 0..(6 * q).max(1) {
                let phi = 2.0 * std::f64::consts::PI * (i as f64 + phase * q as f64 / k as f64) / (6 * q).max(1) as f64;
                m.points.push(place(s, radius(s) * q as f64 / k as f64, phi));
            }
        }
        let mut put = |a: usize, b: usize, c: usize| {
            let t = if patch == 2 { [a, c, b] } else { [a, b, c] };
            m.triangles.push(t.map(|v| v as u32));
            m.patch.push(patch);
        };
        for q in 1..=k {
            let outer = |i: usize| starts[q] + i % (6 * q);
            let inner = |i: usize| starts[q - 1] + i % (6 * (q - 1)).max(1);
            for sector in 0..6 {
                for i in 0..q {
                    let (o, c) = (sector * q + i, sector * (q - 1) + i);
                    put(outer(o), outer(o + 1), inner(c));
                    if i + 1 < q {
                        put(inner(c), outer(o + 1), inner(c + 1));
                    }
                }
            }
        }
    }
    m
}

/// A straight tube from the origin along (1, 2, 2)/3.
pub fn straight(radius: f64, length: f64, k: usize) -> TriMesh {
    let h = 2.0 * radius * (std::f64::consts::PI / (6.0 * k as f64)).sin();
    let rings = (length / (h * 0.75f64.sqrt())).round().max(2.0) as usize;
    let t = Vector::new(1.0, 2.0, 2.0) / 3.0;
    let u = Vector::new(2.0, 1.0, -2.0) / 3.0;
    tube(k, rings, |s| (Point::origin() + t * (s * length), t, u), |_| radius)
}

/// A bent tube (an arc of `angle` with bend radius `bend`) with a narrowing to `neck` of the radius in its middle.
pub fn bent(radius: f64, bend: f64, angle: f64, neck: f64, k: usize) -> TriMesh {
    let h = 2.0 * radius * (std::f64::consts::PI / (6.0 * k as f64)).sin();
    let rings = (bend * angle / (h * 0.75f64.sqrt())).round().max(2.0) as usize;
    tube(
        k,
        rings,
        |s| {
            let a = angle * s;
            let out = Vector::new(a.cos(), a.sin(), 0.0);
            (Point::origin() + out * bend, Vector::new(-a.sin(), a.cos(), 0.0), Vector::z())
        },
        |s| radius * (1.0 - (1.0 - neck) * (-((s - 0.5) / 0.12f64).powi(2)).exp()),
    )
}

//! Developed laminar velocity on a cap of any shape.

use std::collections::BTreeMap;

use crate::geometry::Point;
use crate::mesh::faces::FaceMesh;
use crate::quality::face_geometry;

/// Velocity through each face of `faces`, inwards, m/s, with the exact flow rate `flow` (m³/s) over the cap's faces.
///
/// Solves ∇²u = −1 on the cap with u = 0 on its rim by linear finite elements, so that the profile fits caps of any
/// shape; on a circle it is the paraboloid. A cap without inner vertices gets the same velocity everywhere.
pub fn poisson_profile(mesh: &impl FaceMesh, faces: std::ops::Range<usize>, flow: f64) -> Vec<f64> {
    let (mut ids, mut edges) = (Vec::new(), Vec::new());
    let mut triangles: Vec<[u32; 3]> = vec![];
    for f in faces.clone() {
        let v = mesh.face(f);
        ids.extend_from_slice(v);
        edges.extend((0..v.len()).map(|i| (v[i].min(v[(i + 1) % v.len()]), v[i].max(v[(i + 1) % v.len()]))));
        triangles.extend((1..v.len() - 1).map(|i| [v[0], v[i], v[i + 1]]));
    }
    ids.sort_unstable();
    ids.dedup();
    edges.sort_unstable();
    let local = |v: u32| ids.binary_search(&v).unwrap_or(0);
    let mut rim = vec![false; ids.len()];
    for e in edges.chunk_by(|a, b| a == b).filter(|e| e.len() == 1) {
        rim[local(e[0].0)] = true;
        rim[local(e[0].1)] = true;
    }
    let u = solve(mesh.points(), &ids, &triangles, &rim);
    let areas: Vec<f64> = faces.clone().map(|f| face_geometry(mesh.points(), mesh.face(f)).1.norm() * 1e-6).collect();
    let mut speed: Vec<f64> = faces
        .map(|f| {
            let v = mesh.face(f);
            v.iter().map(|&v| u[local(v)]).sum::<f64>().max(0.0) / v.len() as f64
        })
        .collect();
    let mut through: f64 = speed.iter().zip(&areas).map(|(u, a)| u * a).sum();
    if !(through > 0.0) {
        speed.fill(1.0);
        through = areas.iter().sum();
    }
    speed.iter_mut().for_each(|u| *u *= flow / through);
    speed
}

/// Conjugate gradients on the cotangent matrix of the vertices that are not on the rim.
fn solve(points: &[Point], ids: &[u32], triangles: &[[u32; 3]], rim: &[bool]) -> Vec<f64> {
    let n = ids.len();
    let local = |v: u32| ids.binary_search(&v).unwrap_or(0);
    let mut off: BTreeMap<(usize, usize), f64> = BTreeMap::new();
    let (mut diagonal, mut load) = (vec![0.0; n], vec![0.0; n]);
    for t in triangles {
        let [a, b, c] = t.map(|v| points[v as usize]);
        let twice = (b - a).cross(&(c - a)).norm();
        if !(twice > 0.0) {
            continue;
        }
        let k = t.map(local);
        for i in 0..3 {
            let (p, q, o) = (k[(i + 1) % 3], k[(i + 2) % 3], [a, b, c][i]);
            let w = 0.5 * ([a, b, c][(i + 1) % 3] - o).dot(&([a, b, c][(i + 2) % 3] - o)) / twice;
            *off.entry((p.min(q), p.max(q))).or_default() -= w;
            diagonal[p] += w;
            diagonal[q] += w;
            load[k[i]] += twice / 6.0;
        }
    }
    let off: Vec<((usize, usize), f64)> = off.into_iter().filter(|((p, q), _)| !rim[*p] && !rim[*q]).collect();
    let apply = |x: &[f64]| {
        let mut y: Vec<f64> = x.iter().zip(&diagonal).map(|(x, d)| x * d).collect();
        for &((p, q), w) in &off {
            y[p] += w * x[q];
            y[q] += w * x[p];
        }
        y.iter_mut().zip(rim).for_each(|(y, r)| *y = if *r { 0.0 } else { *y });
        y
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut x = vec![0.0; n];
    let mut r: Vec<f64> = load.iter().zip(rim).map(|(l, r)| if *r { 0.0 } else { *l }).collect();
    let mut p = r.clone();
    let mut rr = dot(&r, &r);
    let goal = rr * 1e-24;
    for _ in 0..4 * n {
        if !(rr > goal) {
            break;
        }
        let ap = apply(&p);
        let alpha = rr / dot(&p, &ap);
        if !alpha.is_finite() {
            break;
        }
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * ap[i];
        }
        let next = dot(&r, &r);
        p.iter_mut().zip(&r).for_each(|(p, r)| *p = r + next / rr * *p);
        rr = next;
    }
    x
}

//! Skeleton voxels as a graph, and the pruning of its spurs.

use super::field::{Field, NONE};

/// A run of skeleton voxels between two nodes, both included.
#[derive(Debug, Clone)]
pub(super) struct Edge {
    pub nodes: [u32; 2],
    /// Lumen numbers from the first node's voxel to the second's.
    pub path: Vec<u32>,
}

/// Edges by index; pruned ones are `None`.
pub(super) struct Graph {
    pub edges: Vec<Option<Edge>>,
    /// The voxel that stands for each node.
    pub nodes: Vec<u32>,
    /// Edge ends at each node; a loop stands twice.
    incident: Vec<Vec<u32>>,
}

impl Graph {
    pub fn new(field: &Field, kept: &[bool]) -> Graph {
        let neighbors = |v: u32| field.neighbors(v).map(|(w, _)| w).filter(|&w| kept[w as usize]);
        let n = kept.len();
        let degree: Vec<u8> =
            (0..n).map(|v| if kept[v] { neighbors(v as u32).count() as u8 } else { u8::MAX }).collect();
        // Junction voxels that touch form one node; the one farthest from the wall stands for it.
        let mut node_of = vec![NONE; n];
        let mut nodes = Vec::new();
        let mut members: Vec<Vec<u32>> = Vec::new();
        for v in 0..n as u32 {
            let d = degree[v as usize];
            if d == u8::MAX || d == 2 || node_of[v as usize] != NONE {
                continue;
            }
            let id = nodes.len() as u32;
            let mut cluster = vec![v];
            node_of[v as usize] = id;
            let mut at = 0;
            while d > 2 && at < cluster.len() {
                for w in neighbors(cluster[at]) {
                    if degree[w as usize] > 2 && node_of[w as usize] == NONE {
                        node_of[w as usize] = id;
                        cluster.push(w);
                    }
                }
                at += 1;
            }
            let best = cluster.iter().copied().fold(v, |a, b| {
                if field.distance[b as usize] > field.distance[a as usize] { b } else { a }
            });
            nodes.push(best);
            members.push(cluster);
        }
        let mut graph = Graph { edges: Vec::new(), incident: vec![Vec::new(); nodes.len()], nodes };
        let mut used = vec![false; n];
        for id in 0..members.len() {
            for &m in &members[id] {
                let starts: Vec<u32> = neighbors(m).collect();
                for s in starts {
                    if node_of[s as usize] != NONE {
                        // Two ends side by side: the only edge without a voxel of its own.
                        if node_of[s as usize] > id as u32 {
                            graph.add(id as u32, node_of[s as usize], &[m, s]);
                        }
                    } else if !used[s as usize] {
                        graph.follow(m, s, &node_of, &mut used, &neighbors);
                    }
                }
            }
        }
        // Rings without a node start anywhere: at their first voxel.
        for v in 0..n as u32 {
            if degree[v as usize] == 2 && !used[v as usize] {
                let id = graph.nodes.len() as u32;
                graph.nodes.push(v);
                graph.incident.push(Vec::new());
                node_of[v as usize] = id;
                used[v as usize] = true;
                if let Some(s) = neighbors(v).next() {
                    graph.follow(v, s, &node_of, &mut used, &neighbors);
                }
            }
        }
        graph
    }

    fn follow<I: Iterator<Item = u32>>(
        &mut self,
        from: u32,
        start: u32,
        node_of: &[u32],
        used: &mut [bool],
        neighbors: &impl Fn(u32) -> I,
    ) {
        let mut path = vec![from, start];
        let (mut last, mut at) = (from, start);
        loop {
            used[at as usize] = true;
            // A run that leaves its node and comes back touches it twice: take the far side when there is one.
            let Some(next) = neighbors(at).find(|&w| w != last) else { break };
            path.push(next);
            if node_of[next as usize] != NONE {
                break;
            }
            if used[next as usize] {
                break;
            }
            (last, at) = (at, next);
        }
        let a = node_of[from as usize];
        let b = node_of[path[path.len() - 1] as usize];
        if a != NONE && b != NONE {
            self.add(a, b, &path);
        }
    }

    fn add(&mut self, a: u32, b: u32, path: &[u32]) {
        let mut full = Vec::with_capacity(path.len() + 2);
        full.push(self.nodes[a as usize]);
        full.extend_from_slice(path);
        full.push(self.nodes[b as usize]);
        full.dedup();
        let e = self.edges.len() as u32;
        self.edges.push(Some(Edge { nodes: [a, b], path: full }));
        self.incident[a as usize].push(e);
        self.incident[b as usize].push(e);
    }

    /// Number of edge ends at a node.
    pub fn degree(&self, node: u32) -> usize {
        self.incident[node as usize].len()
    }

    /// Removes free ends shorter than `factor` radii at their junction plus a voxel, the relatively shortest first.
    /// Returns how many went.
    pub fn prune(&mut self, field: &Field, factor: f64) -> usize {
        let mut removed = 0;
        loop {
            let mut worst: Option<(f64, u32)> = None;
            for (e, edge) in self.edges.iter().enumerate() {
                let Some(edge) = edge else { continue };
                let degrees = edge.nodes.map(|n| self.degree(n));
                let junction = match degrees {
                    [1, d] if d > 2 => edge.nodes[1],
                    [d, 1] if d > 2 => edge.nodes[0],
                    _ => continue,
                };
                let r = field.radius(self.nodes[junction as usize]).max(0.5 * field.voxel_size);
                let Some(ratio) = self.spur(field, edge, junction == edge.nodes[0], r, factor) else { continue };
                if ratio < 1.0 && worst.is_none_or(|(w, _)| ratio < w) {
                    worst = Some((ratio, e as u32));
                }
            }
            let Some((_, e)) = worst else { return removed };
            removed += 1;
            self.remove(e);
        }
    }

    /// How a free end compares with the shortest that is a branch; `None` for those that reach far.
    ///
    /// A spur ends within `factor` radii of its junction (plus a voxel), or it is the corner of a blunt end:
    /// it leaves the junction's sphere, but by less than its own width there, and narrows.
    fn spur(&self, field: &Field, edge: &Edge, forward: bool, r: f64, factor: f64) -> Option<f64> {
        let path: Vec<u32> = if forward { edge.path.clone() } else { edge.path.iter().rev().copied().collect() };
        let center = field.position(path[0]);
        let away = |v: u32| (field.position(v) - center).norm();
        let reach = away(path[path.len() - 1]);
        let ratio = reach / (factor * r + field.voxel_size);
        if ratio < 1.0 {
            return Some(ratio);
        }
        let exit = path.iter().position(|&v| away(v) > r)?;
        let width = 2.0 * field.radius(path[exit]).max(0.5 * field.voxel_size);
        let ratio = (reach - r) / (width + field.voxel_size);
        (reach < 2.2 * r && ratio < 1.0).then_some(ratio)
    }

    fn remove(&mut self, e: u32) {
        let Some(edge) = self.edges[e as usize].take() else { return };
        for n in edge.nodes {
            self.incident[n as usize].retain(|&x| x != e);
            if self.incident[n as usize].len() == 2 {
                self.dissolve(n);
            }
        }
    }

    /// Joins the two edges at a node of degree two; a lone loop keeps its node.
    fn dissolve(&mut self, node: u32) {
        let [a, b] = self.incident[node as usize][..] else { return };
        if a == b {
            return;
        }
        let (Some(mut first), Some(mut second)) = (self.edges[a as usize].take(), self.edges[b as usize].take()) else {
            return;
        };
        if first.nodes[1] != node {
            first.path.reverse();
            first.nodes.reverse();
        }
        if second.nodes[0] != node {
            second.path.reverse();
            second.nodes.reverse();
        }
        first.path.extend_from_slice(&second.path[1..]);
        first.nodes[1] = second.nodes[1];
        self.incident[node as usize].clear();
        for x in &mut self.incident[first.nodes[1] as usize] {
            if *x == b {
                *x = a;
            }
        }
        self.edges[a as usize] = Some(first);
    }
}

fn main() {
    for f in std::env::args().skip(1) {
        let t = std::time::Instant::now();
        match lumenmesh::io::image::read(&f) {
            Ok(i) => {
                let s: f64 = i.values.to_f64().iter().enumerate().map(|(n, v)| v * ((n % 1009) as f64)).sum();
                let l = i.grid.dims.map(|d| (d - 1) as f64);
                let p = i.grid.to_world(nalgebra::Vector3::from(l));
                println!("{{\"f\":{:?},\"dims\":{:?},\"o\":{:?},\"p\":{:?},\"s\":{:?},\"t\":\"{}\",\"ms\":{}}}", f, i.grid.dims, [i.grid.origin.x,i.grid.origin.y,i.grid.origin.z], [p.x,p.y,p.z], s, i.values.type_name(), t.elapsed().as_millis());
            }
            Err(e) => println!("{{\"f\":{:?},\"error\":{:?}}}", f, e.to_string()),
        }
    }
}

//! Many clients at once: no edit that was answered is lost, also when they change what others build on.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Server, add_point, camera};
use serde_json::json;
use std::collections::BTreeMap;

#[test]
fn no_edit_is_lost() {
    const CLIENTS: u64 = 8;
    const EDITS: u64 = 6;
    let server = Server::start();
    let trunk = server.add(0, &add_point(2.0));
    let made: Vec<BTreeMap<u64, u64>> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..CLIENTS)
            .map(|client| {
                let server = &server;
                scope.spawn(move || {
                    let mut socket = server.socket();
                    let (mut parent, mut made) = (trunk, BTreeMap::new());
                    for i in 0..EDITS {
                        socket.ask(&json!({"id": i, "node": parent, "camera": camera(i as f32)}));
                        let id = server
                            .add(parent, &add_point(1.5 + 0.01 * (client * EDITS + i) as f32));
                        made.insert(id, parent);
                        parent = id;
                        while !matches!(socket.next(), Ok((h, _)) if h["id"] == i) {}
                    }
                    made
                })
            })
            .collect();
        // Meanwhile the trunk that all of them build on is changed, again and again.
        let mut changed = 0;
        for round in 0..12 {
            let session = server.session();
            let node = session["nodes"].as_array().unwrap().iter();
            let version = node.into_iter().find(|n| n["id"] == trunk).unwrap()["version"].clone();
            let body = json!({"version": version, "edit": add_point(2.0 + 0.1 * round as f32)});
            let reply = server.json("PUT", &server.path(&format!("nodes/{trunk}")), &body);
            assert!([200, 409].contains(&reply.status), "{}", reply.text());
            changed += u64::from(reply.status == 200);
        }
        assert!(changed > 0);
        clients.into_iter().map(|c| c.join().unwrap()).collect()
    });
    let session = server.session();
    let there: BTreeMap<u64, u64> = session["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|n| Some((n["id"].as_u64()?, n["parent"].as_u64()?)))
        .collect();
    let mut expected: BTreeMap<u64, u64> = made.into_iter().flatten().collect();
    assert_eq!(
        expected.len() as u64,
        CLIENTS * EDITS,
        "every step has a number of its own"
    );
    expected.insert(trunk, 0);
    assert_eq!(there, expected);

    // What stands on the changed trunk was made from it: making a leaf again gives the same picture.
    let (leaf, _) = expected.last_key_value().unwrap();
    let node = |id: u64| {
        let nodes = session["nodes"].as_array().unwrap();
        nodes.iter().find(|n| n["id"] == id).unwrap().clone()
    };
    let picture = |id: u64| {
        let path =
            format!("nodes/{id}/picture/png?azimuth=0.4&elevation=0.4&distance=2.75&fov=0.87");
        server.get(&server.path(&path)).body
    };
    let mut path = vec![*leaf];
    while let Some(parent) = expected.get(&path[path.len() - 1]) {
        path.push(*parent);
    }
    let mut again = 0;
    for id in path.iter().rev().skip(1) {
        again = server.add(again, &node(*id)["edit"]);
    }
    assert_eq!(picture(again), picture(*leaf));
}

//! What tests/wasm computes in WebAssembly is what is computed here.

#[path = "../wasm/scene.rs"]
mod scene;

#[test]
fn wasm_every_method_has_the_result_that_the_other_build_is_compared_with() {
    let sums: Vec<_> = scene::SUMS
        .into_iter()
        .map(|(method, _)| (method, scene::sum(method).unwrap()))
        .collect();
    assert_eq!(sums, scene::SUMS);
}

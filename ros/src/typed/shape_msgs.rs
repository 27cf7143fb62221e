//! The messages of `shape_msgs`, written by `tests/all/typed.rs`.

super::message! {
    Mesh, "shape_msgs/msg/Mesh", "ros.shape.Mesh";
    triangles: Vec<MeshTriangle>,
    vertices: Vec<super::geometry_msgs::Point>,
}

super::message! {
    MeshTriangle, "shape_msgs/msg/MeshTriangle", "ros.shape.MeshTriangle";
    vertex_indices: [u32; 3],
}

super::message! {
    Plane, "shape_msgs/msg/Plane", "ros.shape.Plane";
    coef: [f64; 4],
}

super::message! {
    SolidPrimitive, "shape_msgs/msg/SolidPrimitive", "ros.shape.SolidPrimitive";
    r#type: u8,
    dimensions: super::AtMost<f64, 3>,
    polygon: super::geometry_msgs::Polygon,
    ;
    const BOX: u8 = 1;
    const SPHERE: u8 = 2;
    const CYLINDER: u8 = 3;
    const CONE: u8 = 4;
    const PRISM: u8 = 5;
    const BOX_X: u8 = 0;
    const BOX_Y: u8 = 1;
    const BOX_Z: u8 = 2;
    const SPHERE_RADIUS: u8 = 0;
    const CYLINDER_HEIGHT: u8 = 0;
    const CYLINDER_RADIUS: u8 = 1;
    const CONE_HEIGHT: u8 = 0;
    const CONE_RADIUS: u8 = 1;
    const PRISM_HEIGHT: u8 = 0;
}

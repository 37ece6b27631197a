//! Rooms from the mesh.

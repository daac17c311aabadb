//! The body: skeleton, kinematics, the physics character and the physics optimiser. Pure maths
//! over an immutable model and a cloneable state.

pub mod character;
pub mod motion;
pub mod optimiser;
pub mod qp;
pub mod retarget;
pub mod scene;
pub mod simulation;
pub mod skeleton;

pub use skeleton::{BodyPose, JOINTS, Joint, Joints, Skeleton};

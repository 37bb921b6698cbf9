//! What every fixed-size message has in common, whichever way it travels.

use bytemuck::Pod;

/// A message, or the header of one, that travels as its bytes.
///
/// `Pod` says that it has no padding, no pointer and no invalid value, so a copy of its bytes is the message.
pub trait Message: Pod {
    /// Name and version of its layout. Two programs that disagree about either cannot exchange it.
    const TYPE_NAME: &'static str;
}

//! Messages in the form that iceoryx2 accepts. The messages themselves know no transport.
#![allow(unsafe_code)]

use iceoryx2::prelude::ZeroCopySend;
use trestle_proto::message::Message;

/// A message as it lies in shared memory: the message itself and nothing else.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default)]
pub struct Wire<T>(pub T);

// SAFETY: `T` is `Pod`, so it holds neither pointers, references nor handles, and its layout is fixed (`repr(C)` or
// `repr(transparent)`, which the derive of `Pod` demands). `Wire` is transparent and adds nothing. Its name says which
// layout it is: `Message::TYPE_NAME` carries a version.
unsafe impl<T: Message> ZeroCopySend for Wire<T> {
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trestle_proto::orders::Orders;

    #[test]
    fn a_message_lies_in_shared_memory_as_it_is() {
        assert_eq!(size_of::<Wire<Orders>>(), size_of::<Orders>());
        assert_eq!(align_of::<Wire<Orders>>(), align_of::<Orders>());
        // SAFETY: the name is only read.
        assert_eq!(unsafe { <Wire<Orders> as ZeroCopySend>::type_name() }, "trestle.Orders.v3");
    }
}

//! The counted messages between relays, and the hello of a host.
//!
//! The first byte of a message is its kind. Batches, replies, orders and weights have the layouts of shared memory
//! (`docs/protocol.md`), header first; every number is checked where it is received.

use bytemuck::{Pod, bytes_of, cast_slice, pod_read_unaligned};
use serde::{Deserialize, Serialize};
use std::mem::offset_of;
use trestle_proto::acting::{Acting, ActingHeader};
use trestle_proto::batch::BatchHeader;
use trestle_proto::codec::{self, CodecError, Kind};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::orders::{Orders, Share};
use trestle_proto::reply::{Reply, ReplyHeader};

/// The frame of a [`Hello`].
pub const HELLO_KIND: Kind = Kind { magic: *b"TRHELLO\0", version: 1 };
/// The frame of a [`Grant`].
pub const GRANT_KIND: Kind = Kind { magic: *b"TRGRANT\0", version: 1 };

const GRANT: u8 = 1;
const ORDERS: u8 = 2;
const BATCH: u8 = 3;
const REPLY: u8 = 4;

/// Bytes of orders before the shares.
const ORDERS_HEAD: usize = offset_of!(Orders, shares);

/// A host's description of itself when it wants to join.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The sources that its program was built from.
    pub build: String,
    /// Its name, for people.
    pub name: String,
    /// Actors that it offers, 1 or more.
    pub actors: u32,
}

/// An actor that a host is to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seat {
    /// Its index among all actors of the run.
    pub actor: u32,
    /// The incarnation that it begins as.
    pub incarnation: Incarnation,
}

/// The plan, the actors and the files with which a joined host begins.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grant {
    /// The run's plan, as in `plan.bin`.
    pub plan: Vec<u8>,
    /// The actors that it is to run.
    pub seats: Vec<Seat>,
    /// Files of the checkpoint that the run goes on from: the files that actors read, by name.
    pub files: Vec<(String, Vec<u8>)>,
}

/// A message that has come from the head.
#[derive(Debug)]
pub enum FromHead {
    /// The host's grant.
    Grant(Grant),
    /// Orders, with the shares of the host's actors, and the weights to act with where these have changed.
    Orders(Box<Orders>, Option<(Box<ActingHeader>, Vec<u32>)>),
}

/// A message that has come from a joined host.
#[derive(Debug)]
pub enum FromHost {
    /// A batch: header and payload.
    Batch(Box<BatchHeader>, Vec<u32>),
    /// A reply.
    Reply(Reply),
}

/// A message that cannot be right.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Its first byte, or its length.
    #[error("a message of {0} bytes that is none")]
    Form(usize),
    /// Its contents.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// A host's grant, as a message.
pub fn grant(grant: &Grant) -> Result<Vec<u8>, CodecError> {
    Ok([&[GRANT][..], &codec::encode(GRANT_KIND, grant)?].concat())
}

/// Orders for the host of `actors` as a message, with what to act with where that has changed.
pub fn orders(orders: &Orders, actors: &[u32], acting: Option<(&ActingHeader, &Acting)>) -> Vec<u8> {
    let mut message = vec![ORDERS];
    message.extend_from_slice(&bytes_of(orders)[..ORDERS_HEAD]);
    for &actor in actors {
        message.extend_from_slice(bytes_of(&orders.shares[actor as usize]));
    }
    if let Some((header, acting)) = acting {
        let mut words = vec![0; acting.words()];
        acting.write(&mut words);
        message.extend_from_slice(bytes_of(header));
        message.extend_from_slice(cast_slice(&words));
    }
    message
}

/// A batch as a message.
pub fn batch(header: &BatchHeader, payload: &[u32]) -> Vec<u8> {
    [&[BATCH], bytes_of(header), cast_slice(payload)].concat()
}

/// A reply as a message.
pub fn reply(reply: &Reply) -> Vec<u8> {
    [&[REPLY], bytes_of(&reply.header), &reply.payload].concat()
}

/// The beginning of `bytes` as a `T`, and the rest.
fn split<T: Pod>(bytes: &[u8]) -> Result<(T, &[u8]), MessageError> {
    let (head, rest) = bytes.split_at_checked(size_of::<T>()).ok_or(MessageError::Form(bytes.len()))?;
    Ok((pod_read_unaligned(head), rest))
}

/// `bytes` as words.
fn words(bytes: &[u8]) -> Result<Vec<u32>, MessageError> {
    let (words, rest) = bytes.as_chunks::<4>();
    match rest {
        [] => Ok(words.iter().map(|&word| u32::from_le_bytes(word)).collect()),
        _ => Err(MessageError::Form(bytes.len())),
    }
}

impl FromHead {
    /// The message in `bytes`, for the host of `actors`. Its contents are still to be checked.
    pub fn decode(bytes: &[u8], actors: &[u32]) -> Result<Self, MessageError> {
        match bytes.split_first() {
            Some((&GRANT, body)) => Ok(Self::Grant(codec::decode(GRANT_KIND, body)?)),
            Some((&ORDERS, body)) => {
                let (head, mut rest) =
                    body.split_at_checked(ORDERS_HEAD).ok_or(MessageError::Form(bytes.len()))?;
                let mut orders = Box::<Orders>::default();
                bytemuck::bytes_of_mut(&mut *orders)[..ORDERS_HEAD].copy_from_slice(head);
                for &actor in actors {
                    let (share, more) = split::<Share>(rest)?;
                    *orders.shares.get_mut(actor as usize).ok_or(MessageError::Form(bytes.len()))? = share;
                    rest = more;
                }
                if rest.is_empty() {
                    return Ok(Self::Orders(orders, None));
                }
                let (header, payload) = split::<ActingHeader>(rest)?;
                Ok(Self::Orders(orders, Some((Box::new(header), words(payload)?))))
            }
            _ => Err(MessageError::Form(bytes.len())),
        }
    }
}

impl FromHost {
    /// The message in `bytes`. Its contents are still to be checked.
    pub fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
        match bytes.split_first() {
            Some((&BATCH, body)) => {
                let (header, payload) = split(body)?;
                Ok(Self::Batch(Box::new(header), words(payload)?))
            }
            Some((&REPLY, body)) => {
                let (header, payload) = split::<ReplyHeader>(body)?;
                Ok(Self::Reply(Reply { header, payload: payload.to_vec() }))
            }
            _ => Err(MessageError::Form(bytes.len())),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::batch::Batch;

    #[test]
    fn messages_come_back_as_they_were() {
        let mut given = Orders { run: 7, round: 3.into(), weights_version: 2.into(), ..Orders::default() };
        given.shares[5].granted = 9;
        given.shares[6].granted = 10;
        let acting = Acting::of_weights(vec![1.0, -2.0]);
        let header = ActingHeader::new(7, 0, 2.into(), &[1, 1], &acting);
        for with in [None, Some((&header, &acting))] {
            let message = orders(&given, &[5, 6], with);
            match FromHead::decode(&message, &[5, 6]).unwrap() {
                FromHead::Orders(orders, came) => {
                    assert_eq!(*orders, given);
                    let words = vec![1f32.to_bits(), (-2f32).to_bits()];
                    assert_eq!(came, with.map(|(header, _)| (Box::new(*header), words)));
                }
                other => panic!("{other:?}"),
            }
            assert!(FromHead::decode(&message[..message.len() - 1], &[5, 6]).is_err());
            assert!(FromHead::decode(&message, &[5, 64]).is_err());
        }
        let sent =
            Reply { header: ReplyHeader { actor: 3, ..ReplyHeader::default() }, payload: vec![1, 2, 3] };
        assert!(matches!(FromHost::decode(&reply(&sent)).unwrap(), FromHost::Reply(came) if came == sent));
        let mut sent = Batch::default();
        sent.prepare(BatchHeader { actor: 3, count: 2, obs_dim: 1, ..BatchHeader::default() });
        match FromHost::decode(&batch(&sent.header, sent.payload())).unwrap() {
            FromHost::Batch(header, payload) => {
                assert!(*header == sent.header && payload == sent.payload());
            }
            other => panic!("{other:?}"),
        }
        for none in [&[][..], &[9], &[BATCH, 1], &[GRANT, 0], &[ORDERS]] {
            assert!(FromHost::decode(none).is_err() && FromHead::decode(none, &[]).is_err());
        }
    }
}

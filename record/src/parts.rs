//! Reader of the records of an MCAP file, one by one, also of a damaged file: unreadable parts are reported and skipped, in
//! bounded time and memory, and reading continues after them.

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, parse_record};
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Length limit of a record and of the contents of a chunk, bytes: ten times a chunk of this program. It bounds the memory that a
/// damaged length can request.
pub(super) const LONGEST: usize = 16 << 20;
/// Largest compression ratio of a chunk. Cycles reach 5; a larger ratio is a decompression bomb.
const GROWTH: u64 = 1000;
/// Size of the opcode and length before each record, bytes.
const HEAD: usize = 9;
/// Size of the end of a complete file, bytes: the footer record and the magic bytes.
const TAIL: usize = HEAD + 20 + MAGIC.len();

/// Result of reading one record of a file, on the outermost level.
pub(super) enum FilePart<'a> {
    /// A record, possibly a chunk, see [`each_record`].
    Record {
        /// An opcode of [`op`], or one that the format reserves for applications.
        opcode: u8,
        /// Bytes after opcode and length.
        body: &'a [u8],
    },
    /// A long attachment of another tool, skipped.
    Foreign,
    /// A record that is too long to be read, with the reason; reading continues after it.
    Skipped(PartError),
    /// The file is unreadable from here on, with the reason, unless [`FileParts::resume`] finds a later chunk.
    Cut(PartError),
    /// End of the file.
    End,
}

/// Reason why a part of a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum PartError {
    /// The file ends in the head of a record.
    #[error("{left} bytes are no record")]
    NoRecord {
        /// Bytes up to the end of the file.
        left: u64,
    },
    /// MCAP has no record with this opcode.
    #[error("there is no record with opcode {opcode:#04x}")]
    Opcode {
        /// The opcode in the file.
        opcode: u8,
    },
    /// The file ends in the body of a record.
    #[error("a record of {length} bytes where {left} are left")]
    Truncated {
        /// Length of the body, bytes.
        length: u64,
        /// Bytes up to the end of the file.
        left: u64,
    },
    /// The record is longer than [`LONGEST`].
    #[error("a record of {length} bytes, of which {LONGEST} can be read")]
    TooLong {
        /// Length of the body, bytes.
        length: u64,
    },
    /// The file was truncated while it was read.
    #[error("the file became shorter")]
    Shortened,
    /// The contents of a chunk are more than [`GROWTH`] times as long as the chunk.
    #[error("a chunk that grows from {compressed} to {size} bytes")]
    Growth {
        /// Length of the chunk, bytes.
        compressed: u64,
        /// Length of its contents, bytes.
        size: u64,
    },
    /// The MCAP library cannot read the record or chunk.
    #[error(transparent)]
    Mcap(#[from] mcap::McapError),
}

/// An MCAP file, read from its start to its end.
pub(super) struct FileParts {
    file: BufReader<File>,
    length: u64,
    /// Offsets of the newest record, and of the record that follows it, bytes.
    start: u64,
    next: u64,
    body: Vec<u8>,
    /// Read once the first damage is found.
    index: Option<FileIndex>,
}

/// Contents of the summary at the end of a complete file.
#[derive(Default)]
struct FileIndex {
    /// Offsets of the chunks, bytes, in ascending order.
    chunks: Vec<u64>,
    /// Opcodes and bodies of schemas and channels: those in the data section may be damaged.
    definitions: Vec<(u8, Vec<u8>)>,
}

impl FileParts {
    /// Opens a file; `None` if it is no MCAP file.
    pub fn open(path: &Path) -> io::Result<Option<Self>> {
        let file = upswing_config::open_file(path)?;
        let length = file.metadata()?.len();
        let mut file = BufReader::new(file);
        let mut magic = [0; MAGIC.len()];
        match file.read_exact(&mut magic) {
            Ok(()) if magic == *MAGIC => {}
            Err(e) if e.kind() != ErrorKind::UnexpectedEof => return Err(e),
            _ => return Ok(None),
        }
        let next = MAGIC.len() as u64;
        Ok(Some(Self { file, length, start: next, next, body: Vec::new(), index: None }))
    }

    /// Offset of the newest record and length of the file, bytes.
    pub fn place(&self) -> (u64, u64) {
        (self.start, self.length)
    }

    /// Reads the next record.
    pub fn next(&mut self) -> io::Result<FilePart<'_>> {
        self.start = self.next;
        let left = self.length.saturating_sub(self.start);
        if left == 0 {
            return Ok(FilePart::End);
        }
        let mut head = [0; HEAD];
        if left < HEAD as u64 || !whole(self.file.read_exact(&mut head))? {
            return Ok(FilePart::Cut(PartError::NoRecord { left }));
        }
        let (opcode, length) = (head[0], u64::from_le_bytes(head[1..].try_into().unwrap_or_default()));
        // Opcodes from 0x80 on are reserved for applications.
        if !(op::HEADER..=op::DATA_END).contains(&opcode) && opcode < 0x80 {
            return Ok(FilePart::Cut(PartError::Opcode { opcode }));
        }
        let behind = left - HEAD as u64;
        if length > behind {
            return Ok(FilePart::Cut(PartError::Truncated { length, left: behind }));
        }
        self.next = self.start + HEAD as u64 + length;
        if length > LONGEST as u64 {
            self.file.seek(SeekFrom::Start(self.next))?;
            return Ok(match opcode {
                op::ATTACHMENT => FilePart::Foreign,
                _ => FilePart::Skipped(PartError::TooLong { length }),
            });
        }
        self.body.resize(length as usize, 0);
        Ok(match whole(self.file.read_exact(&mut self.body))? {
            true => FilePart::Record { opcode, body: &self.body },
            false => FilePart::Cut(PartError::Shortened),
        })
    }

    /// Continues at the next chunk of the index in the summary; returns whether there is one.
    pub fn resume(&mut self) -> io::Result<bool> {
        let start = self.start;
        let mut found = false;
        let chunks = self.index()?.chunks.clone();
        for chunk in chunks.into_iter().filter(|chunk| *chunk > start) {
            self.file.seek(SeekFrom::Start(chunk))?;
            let mut opcode = [0];
            if whole(self.file.read_exact(&mut opcode))? && opcode[0] == op::CHUNK {
                (self.next, found) = (chunk, true);
                break;
            }
        }
        self.file.seek(SeekFrom::Start(self.next))?;
        Ok(found)
    }

    /// Opcodes and bodies of the schemas and channels in the summary: those in the data section may be damaged.
    pub fn definitions(&mut self) -> io::Result<&[(u8, Vec<u8>)]> {
        Ok(&self.index()?.definitions)
    }

    fn index(&mut self) -> io::Result<&FileIndex> {
        if self.index.is_none() {
            self.index = Some(self.read_index()?);
            self.file.seek(SeekFrom::Start(self.next))?;
        }
        Ok(self.index.get_or_insert_default())
    }

    /// Reads the summary; the index is empty if the file is not complete.
    fn read_index(&mut self) -> io::Result<FileIndex> {
        let mut index = FileIndex::default();
        let Some(footer) = self.length.checked_sub(TAIL as u64) else { return Ok(index) };
        self.file.seek(SeekFrom::Start(footer))?;
        let mut tail = [0; TAIL];
        if !whole(self.file.read_exact(&mut tail))? || !tail.ends_with(MAGIC) {
            return Ok(index);
        }
        let Ok(Record::Footer(record)) = parse_record(tail[0], &tail[HEAD..TAIL - MAGIC.len()]) else {
            return Ok(index);
        };
        let size = footer.checked_sub(record.summary_start).filter(|size| *size <= LONGEST as u64);
        let Some(size) = size.filter(|_| record.summary_start > 0) else { return Ok(index) };
        self.file.seek(SeekFrom::Start(record.summary_start))?;
        let mut summary = vec![0; size as usize];
        if !whole(self.file.read_exact(&mut summary))? {
            return Ok(index);
        }
        let mut rest = &summary[..];
        while let Some((head, more)) = rest.split_first_chunk::<HEAD>() {
            let length = u64::from_le_bytes(head[1..].try_into().unwrap_or_default());
            let Some((body, more)) = usize::try_from(length).ok().and_then(|n| more.split_at_checked(n))
            else {
                break;
            };
            match head[0] {
                opcode @ (op::SCHEMA | op::CHANNEL) => index.definitions.push((opcode, body.to_vec())),
                op::CHUNK_INDEX => {
                    if let Ok(Record::ChunkIndex(chunk)) = parse_record(op::CHUNK_INDEX, body) {
                        index.chunks.push(chunk.chunk_start_offset);
                    }
                }
                _ => {}
            }
            rest = more;
        }
        index.chunks.sort_unstable();
        Ok(index)
    }
}

/// Whether a read was complete; the end of the file is no error.
fn whole(read: io::Result<()>) -> io::Result<bool> {
    match read {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| true),
    }
}

/// Calls `each` with the record, or with the records in it if it is a chunk. `Ok(Err)`: the reason why the record, or the rest
/// of the chunk, is unreadable; of a chunk with a wrong checksum no record is read.
///
/// # Errors
/// The error of `each`.
pub(super) fn each_record<E>(
    opcode: u8,
    body: &[u8],
    mut each: impl FnMut(Record<'_>) -> Result<(), E>,
) -> Result<Result<(), PartError>, E> {
    let header = match parse_record(opcode, body) {
        Err(e) => return Ok(Err(e.into())),
        Ok(Record::Chunk { header, .. }) => header,
        Ok(record) => return each(record).map(Ok),
    };
    let (size, compressed) = (header.uncompressed_size, header.compressed_size);
    if !header.compression.is_empty() && size / GROWTH > compressed {
        return Ok(Err(PartError::Growth { compressed, size }));
    }
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LONGEST);
    let mut reader = LinearReader::new_with_options(options);
    let head = [&[opcode][..], &(body.len() as u64).to_le_bytes()].concat();
    let mut rest = (&head[..]).chain(body);
    while let Some(event) = reader.next_event() {
        let record = match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                // Reads from memory cannot fail; 0 bytes are the end.
                let got = rest.read(reader.insert(need.min(LONGEST))).unwrap_or(0);
                reader.notify_read(got);
                continue;
            }
            Ok(LinearReadEvent::Record { data, opcode }) => parse_record(opcode, data),
            Err(e) => Err(e),
        };
        match record {
            Ok(record) => each(record)?,
            Err(e) => return Ok(Err(e.into())),
        }
    }
    Ok(Ok(()))
}

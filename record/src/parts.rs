//! The records of an MCAP file one by one, however damaged: what cannot be read is named and left out, in bounded time and
//! memory, and reading goes on behind it.

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, parse_record};
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Longest record that is read, and longest contents of a chunk, bytes: ten times a chunk of this program. A damaged length
/// asks for no more memory than this.
pub(super) const LONGEST: usize = 16 << 20;
/// Bytes of a chunk per compressed byte at most. Cycles reach 5; what grows more is made to keep a reader busy.
const GROWTH: u64 = 1000;
/// Opcode and length in front of each record; a footer with them and the mark at the end of the file.
const HEAD: usize = 9;
const TAIL: usize = HEAD + 20 + MAGIC.len();

/// One record of a file, on its outermost level.
pub(super) enum Part<'a> {
    /// It may be a chunk, see [`each_record`].
    Record {
        /// One of [`op`], or one that this format leaves to others.
        opcode: u8,
        /// What follows opcode and length.
        body: &'a [u8],
    },
    /// A long attachment of another tool.
    Foreign,
    /// It is too long to be read; reading goes on behind it.
    TooLong(String),
    /// From here on nothing can be read, unless [`Parts::resume`] finds more.
    Cut(String),
    /// All has been read.
    End,
}

/// Reads a file from its start to its end.
pub(super) struct Parts {
    file: BufReader<File>,
    length: u64,
    /// Of the newest record, and of the one that follows it.
    start: u64,
    next: u64,
    body: Vec<u8>,
    /// Looked up once something is damaged.
    index: Option<Index>,
}

/// What the end of a complete file says about its parts.
#[derive(Default)]
struct Index {
    /// Where chunks begin, in ascending order.
    chunks: Vec<u64>,
    /// Schemas and channels, which may have been in the damaged part.
    definitions: Vec<(u8, Vec<u8>)>,
}

impl Parts {
    /// `None`: the file is no MCAP.
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

    /// Bytes before the newest record, and of the file.
    pub fn place(&self) -> (u64, u64) {
        (self.start, self.length)
    }

    /// The next record.
    pub fn next(&mut self) -> io::Result<Part<'_>> {
        self.start = self.next;
        let left = self.length.saturating_sub(self.start);
        if left == 0 {
            return Ok(Part::End);
        }
        let mut head = [0; HEAD];
        if left < HEAD as u64 || !whole(self.file.read_exact(&mut head))? {
            return Ok(Part::Cut(format!("{left} bytes are no record")));
        }
        let (opcode, length) = (head[0], u64::from_le_bytes(head[1..].try_into().unwrap_or_default()));
        // From 0x80 on they are left to others.
        if !(op::HEADER..=op::DATA_END).contains(&opcode) && opcode < 0x80 {
            return Ok(Part::Cut(format!("there is no record with opcode {opcode:#04x}")));
        }
        let behind = left - HEAD as u64;
        if length > behind {
            return Ok(Part::Cut(format!("a record of {length} bytes where {behind} are left")));
        }
        self.next = self.start + HEAD as u64 + length;
        if length > LONGEST as u64 {
            self.file.seek(SeekFrom::Start(self.next))?;
            return Ok(match opcode {
                op::ATTACHMENT => Part::Foreign,
                _ => Part::TooLong(format!("a record of {length} bytes, of which {LONGEST} can be read")),
            });
        }
        self.body.resize(length as usize, 0);
        Ok(match whole(self.file.read_exact(&mut self.body))? {
            true => Part::Record { opcode, body: &self.body },
            false => Part::Cut("the file became shorter".into()),
        })
    }

    /// Goes on at the next chunk that the end of the file knows of; whether there is one.
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

    /// Schemas and channels at the end of the file: those in front may be damaged.
    pub fn definitions(&mut self) -> io::Result<&[(u8, Vec<u8>)]> {
        Ok(&self.index()?.definitions)
    }

    fn index(&mut self) -> io::Result<&Index> {
        if self.index.is_none() {
            self.index = Some(self.read_index()?);
            self.file.seek(SeekFrom::Start(self.next))?;
        }
        Ok(self.index.get_or_insert_default())
    }

    /// An empty one of a file that is not complete.
    fn read_index(&mut self) -> io::Result<Index> {
        let mut index = Index::default();
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

/// Whether something was read whole; the end of the file is no error.
fn whole(read: io::Result<()>) -> io::Result<bool> {
    match read {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| true),
    }
}

/// Gives `each` the record, or those in it if it is a chunk; of a damaged chunk none. `Ok(Err)`: why it cannot be read.
///
/// # Errors
/// What `each` says.
pub(super) fn each_record<E>(
    opcode: u8,
    body: &[u8],
    mut each: impl FnMut(Record<'_>) -> Result<(), E>,
) -> Result<Result<(), String>, E> {
    let header = match parse_record(opcode, body) {
        Err(e) => return Ok(Err(e.to_string())),
        Ok(Record::Chunk { header, .. }) => header,
        Ok(record) => return each(record).map(Ok),
    };
    let (size, compressed) = (header.uncompressed_size, header.compressed_size);
    if !header.compression.is_empty() && size / GROWTH > compressed {
        return Ok(Err(format!("a chunk that grows from {compressed} to {size} bytes")));
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
                // From memory, which does not fail; nothing more is the end.
                let got = rest.read(reader.insert(need.min(LONGEST))).unwrap_or(0);
                reader.notify_read(got);
                continue;
            }
            Ok(LinearReadEvent::Record { data, opcode }) => parse_record(opcode, data),
            Err(e) => Err(e),
        };
        match record {
            Ok(record) => each(record)?,
            Err(e) => return Ok(Err(e.to_string())),
        }
    }
    Ok(Ok(()))
}

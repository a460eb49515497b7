//! A recording contains every cycle bit for bit, up to the last complete chunk of a truncated file; a file that is no recording
//! is refused.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::path::Path;
use upswing_config::Config;
use upswing_ipc::{Measurement, Mode, PlanHeader, PlanMessage, RecordedStep, Telemetry};
use upswing_model::{ActuatedVector, JointVector};
use upswing_record::cycle::{CYCLE, CycleNumber, layout_of};
use upswing_record::replay::{RecordedRun, ReplayError, replay};
use upswing_record::{CHUNK, JOINTS, Message, Recorder, Recording, RecordingError, Window, read, scan};

fn record(seq: u64) -> Telemetry {
    let (t_ns, mode) = (seq * 125_000, seq % 6);
    let mut t = Telemetry { seq, t_ns, mode, joints: 9, actuated: 7, ..Telemetry::default() };
    for i in 0..9 {
        (t.q[i], t.qd[i]) = ((seq as f64 * 1e-3 + i as f64).sin(), -0.0);
    }
    (t.tau[6], t.write_ns) = (f64::MIN_POSITIVE, u64::MAX - seq);
    t
}

/// Records `cycles` in a new file in `dir`, in batches like those of the daemon.
fn recorded(dir: &Path, cycles: &[Telemetry]) -> std::path::PathBuf {
    let path = dir.join("run.mcap");
    let config = Config::embedded().expect("the settings load");
    let mut recorder =
        Recorder::create(&path, &config, [("clock", "lockstep".into())]).expect("the file is made");
    for batch in cycles.chunks(64) {
        recorder.write(batch).expect("written");
    }
    let tally = recorder.finish().expect("finished");
    assert_eq!(tally.cycles, cycles.len() as u64);
    path
}

#[test]
fn all_fields_of_all_cycles() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=CHUNK as u64 + 500).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let (read_back, recording) = read(&path, Window::ALL).expect("it reads");
    assert_eq!((&read_back, &recording.cut), (&cycles, &None));
    assert_eq!(recording.details["clock"], "lockstep");
    let config = Config::embedded().expect("the settings load");
    assert_eq!(recording.file_text("robot.urdf"), Some(config.urdf.as_str()));
    let (part, _) = read(&path, Window { from: 0.01, to: 0.02 }).expect("it reads");
    assert_eq!((part[0].seq, part.len()), (81, 81));
}

#[test]
fn lost_cycles_and_restarts_are_counted() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = Config::embedded().expect("the settings load");
    let mut recorder = Recorder::create(&dir.path().join("a.mcap"), &config, []).expect("made");
    recorder.write(&[7, 8, 11, 1, 2].map(record)).expect("written");
    let tally = recorder.tally();
    assert_eq!((tally.cycles, tally.lost, tally.restarts), (5, 2, 1));
}

#[test]
fn an_existing_file_is_kept() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("run.mcap");
    std::fs::write(&path, "precious").expect("written");
    let config = Config::embedded().expect("the settings load");
    assert!(matches!(Recorder::create(&path, &config, []), Err(RecordingError::Create { .. })));
    assert_eq!(std::fs::read(&path).expect("read"), b"precious");
}

#[test]
fn other_messages_are_refused() {
    let good = CYCLE.encode(record(3).words());
    let decoded = CYCLE.decode(&good).expect("a cycle");
    assert_eq!(Telemetry::from_words(&decoded), Some(record(3)));
    for bad in [&good[..good.len() - 1], &good[..good.len() - 8], &good[4..], &[]] {
        assert_eq!(CYCLE.decode(bad), None);
    }
    // The length of each list.
    let lengths = good.windows(4).enumerate().filter(|(_, bytes)| matches!(bytes, [9 | 7, 0, 0, 0]));
    let lengths: Vec<_> = lengths.map(|(at, _)| at).filter(|at| at % 4 == 0).collect();
    assert_eq!(lengths.len(), 8);
    for at in lengths {
        for length in [0, 1, 8, 17, u32::MAX] {
            let mut bad = good.clone();
            bad[at..at + 4].copy_from_slice(&length.to_le_bytes());
            assert_eq!(CYCLE.decode(&bad), None, "{length} at byte {at}");
        }
    }
    // The definition names each field and each mode.
    let definition = CYCLE.definition();
    let balance = format!("uint64 BALANCE={}", Mode::Balance.code());
    for text in ["float64[] q", "uint64 wake_ns", &balance] {
        assert!(layout_of(&definition).contains(&text), "{text} in {definition}");
    }
}

#[test]
fn each_number_has_its_joint_and_its_unit() {
    let config = Config::embedded().expect("the settings load");
    let numbers = CycleNumber::all(&config.model);
    assert_eq!(numbers.len(), 15 + 4 * 9 + 4 * 7);
    let words: Vec<_> = record(3).words().collect();
    let of = |field: &str, joint: Option<&str>| {
        let number = numbers.iter().find(|n| n.field == field && n.joint.as_deref() == joint);
        number.map(|n| (n.text(&words), n.unit))
    };
    assert_eq!(of("seq", None), Some(("3".into(), "")));
    assert_eq!(of("q", Some("pendulum_2")), Some((record(3).q[8].to_string(), "rad")));
    assert_eq!(of("tau", Some("joint_7")), Some((f64::MIN_POSITIVE.to_string(), "N m")));
    assert_eq!(of("u", Some("pendulum_1")), None);
}

#[test]
fn steps_and_plans_come_back() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("run.mcap");
    let config = Config::embedded().expect("the settings load");
    let mut recorder = Recorder::create(&path, &config, []).expect("the file is made");
    let sizes = config.model.sizes();
    let length = PlanMessage::length(sizes, 20);
    let values: Vec<_> = (0..length).map(|i| (i as f64).sin()).collect();
    let header = PlanHeader { id: 5, joints: 9, actuated: 7, intervals: 20, ..PlanHeader::default() };
    let mut plan = PlanMessage { header, values };
    plan.seal();
    recorder.write_plan(&plan).expect("written");
    // Before the first measurement, and with that of another robot, which the controller refuses.
    let q = JointVector::from_fn(sizes, |i| 0.1 * i as f64);
    let tau = ActuatedVector::repeat(sizes, 3.0);
    let measurements = [
        Measurement::default(),
        Measurement { seq: 1, ..Measurement::new(config.model.order(), &q, &tau) },
        Measurement { seq: 2, joints: 3, actuated: 1, ..Measurement::default() },
    ];
    let steps =
        measurements.map(|measurement| RecordedStep { number: 4, measurement, ..RecordedStep::default() });
    recorder.write_steps(&steps).expect("written");
    recorder.write(&[record(1)]).expect("written");
    let mut longer = plan.clone();
    longer.values.push(0.0);
    assert!(matches!(recorder.write_plan(&longer), Err(RecordingError::Plan(_))));
    recorder.finish().expect("finished");

    let (mut plans, mut read_back) = (Vec::new(), Vec::new());
    let keep = |_: &Recording, message| -> Result<(), RecordingError> {
        match message {
            Message::Plan(plan) => plans.push(plan),
            Message::Step(step) => read_back.push(step),
            Message::Cycle(_) => {}
        }
        Ok(())
    };
    scan(&path, Window::ALL, |_, _| (), keep).expect("it reads");
    assert_eq!((plans, read_back), (vec![plan], steps.to_vec()));
}

#[test]
fn another_robot_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = Config::embedded().expect("the settings load");
    let small = |seq| Telemetry { joints: 2, actuated: 1, ..record(seq) };
    let mut recorder = Recorder::create(&dir.path().join("a.mcap"), &config, []).expect("made");
    recorder.write(&[record(1)]).expect("written");
    assert!(matches!(recorder.write(&[small(2)]), Err(RecordingError::OtherChain(_))));
    recorder.finish().expect("finished");

    // The same numbers of joints with other names.
    let path = dir.path().join("b.mcap");
    let details = [(JOINTS, "a,b,c,d,e,f,g,h,i".to_owned())];
    let mut recorder = Recorder::create(&path, &config, details).expect("made");
    recorder.write(&[record(1)]).expect("written");
    recorder.finish().expect("finished");
    let run = RecordedRun::read(&path).expect("it reads");
    assert!(matches!(replay(&run, &config), Err(ReplayError::OtherRobot { .. })));

    // Other numbers of joints.
    let run = RecordedRun { cycles: vec![small(1)], ..RecordedRun::default() };
    assert!(matches!(replay(&run, &config), Err(ReplayError::OtherChain(_))));
}

#[test]
fn another_kind_of_file_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("x.mcap");
    std::fs::write(&path, "no recording").expect("written");
    assert!(matches!(read(&path, Window::ALL), Err(RecordingError::NotMcap { .. })));
    let path = dir.path().join("gone.mcap");
    assert!(matches!(read(&path, Window::ALL), Err(RecordingError::Read { .. })));
}

#[test]
fn a_file_cut_anywhere_is_readable_to_its_last_chunk() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=4 * CHUNK as u64).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let whole = std::fs::read(&path).expect("read");
    let mut most = 0;
    for eighth in 1..8 {
        std::fs::write(&path, &whole[..whole.len() * eighth / 8]).expect("written");
        match read(&path, Window::ALL) {
            Ok((read_back, recording)) => {
                let n = read_back.len();
                assert!(recording.cut.is_some() && n >= most, "{n} cycles in {eighth}/8");
                assert!(n >= CHUNK * (eighth / 2).saturating_sub(1), "{n} cycles in {eighth}/8");
                assert_eq!(read_back, cycles[..n]);
                most = n;
            }
            // The file ends before the first chunk is complete.
            Err(RecordingError::Missing { .. }) => assert_eq!(most, 0),
            Err(e) => panic!("{eighth}/8: {e}"),
        }
    }
    assert!(most >= 2 * CHUNK, "{most} cycles");
}

/// Rewrites a file: replaces each record by the bytes that `change` returns for its opcode and body.
fn rewritten(bytes: &[u8], mut change: impl FnMut(u8, &[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut rest, mut out) = (&bytes[8..bytes.len() - 8], bytes[..8].to_vec());
    while let Some((head, more)) = rest.split_first_chunk::<9>() {
        let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes")) as usize;
        out.extend(change(head[0], &more[..length]));
        rest = &more[length..];
    }
    out.extend(&bytes[bytes.len() - 8..]);
    out
}

fn part(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// A chunk record with arbitrary values in its header.
fn chunk(size: u64, crc: u32, compression: &str, data: &[u8]) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(size.to_le_bytes());
    body.extend(crc.to_le_bytes());
    body.extend((compression.len() as u32).to_le_bytes());
    body.extend(compression.as_bytes());
    body.extend((data.len() as u64).to_le_bytes());
    body.extend(data);
    part(mcap::records::op::CHUNK, &body)
}

/// `bytes` with a chunk in front of the first one.
fn with_chunk(bytes: &[u8], extra: &[u8]) -> Vec<u8> {
    let mut first = true;
    rewritten(bytes, |opcode, body| {
        let before = opcode == mcap::records::op::CHUNK && std::mem::take(&mut first);
        [if before { extra } else { &[] }, &part(opcode, body)].concat()
    })
}

#[test]
fn a_change_of_robots_in_a_file_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = recorded(dir.path(), &(1..=2).map(record).collect::<Vec<_>>());
    let bytes = std::fs::read(&path).expect("read");
    // The summary repeats the channels: number, number of the schema, length of the topic, topic.
    let mut channel = None;
    rewritten(&bytes, |opcode, body| {
        if opcode == mcap::records::op::CHANNEL && body[8..].starts_with(b"/upswing/cycle") {
            channel = Some([body[0], body[1]]);
        }
        Vec::new()
    });
    let mut message = channel.expect("a channel").to_vec();
    message.resize(22, 0);
    message.extend(CYCLE.encode(Telemetry { joints: 2, actuated: 1, ..record(3) }.words()));
    let message = part(mcap::records::op::MESSAGE, &message);
    let extra = chunk(message.len() as u64, 0, "", &message);
    // After the first chunk, which contains the definitions.
    let mut first = true;
    let mixed = rewritten(&bytes, |opcode, body| {
        let after = opcode == mcap::records::op::CHUNK && std::mem::take(&mut first);
        [part(opcode, body), if after { extra.clone() } else { Vec::new() }].concat()
    });
    std::fs::write(&path, mixed).expect("written");
    let refused = read(&path, Window::ALL);
    assert!(
        matches!(refused, Err(RecordingError::Joints { expected: (2, 1), got: (9, 7), .. })),
        "{refused:?}"
    );
}

#[test]
fn attachments_of_other_tools_are_skipped() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=3).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let bytes = std::fs::read(&path).expect("read");
    let own = read(&path, Window::ALL).expect("it reads").1.files;
    for size in [100, 17 << 20] {
        let mut body = vec![0; 16];
        for text in ["camera.bin", "application/octet-stream"] {
            body.extend((text.len() as u32).to_le_bytes());
            body.extend(text.as_bytes());
        }
        body.extend((size as u64).to_le_bytes());
        // No checksum.
        body.resize(body.len() + size + 4, 0);
        let attachment = part(mcap::records::op::ATTACHMENT, &body);
        std::fs::write(&path, with_chunk(&bytes, &attachment)).expect("written");
        let (read_back, recording) = read(&path, Window::ALL).expect("it reads");
        assert_eq!((read_back, recording.damage, recording.cut), (cycles.clone(), None, None), "{size}");
        assert_eq!(recording.files, own, "{size}");
    }
}

#[test]
fn bombs_are_left_out() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=3).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let bytes = std::fs::read(&path).expect("read");
    // A frame of 2 GiB of zeros in blocks of one repeated byte, RFC 8878: 4 bytes each.
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x58];
    for i in 0..16384_u32 {
        let header = (131_072 << 3) | (1 << 1) | u32::from(i == 16383);
        frame.extend(&header.to_le_bytes()[..3]);
        frame.push(0);
    }
    for size in [1 << 20, 8 << 20, 1 << 31, u64::MAX] {
        std::fs::write(&path, with_chunk(&bytes, &chunk(size, 1, "zstd", &frame))).expect("written");
        let (read_back, recording) = read(&path, Window::ALL).expect("it reads");
        assert_eq!((&read_back, recording.cut), (&cycles, None), "{size}");
        assert!(
            recording.damage.is_some_and(|why| why.starts_with("a part is left out, at byte ")),
            "{size}"
        );
    }
}

#[test]
fn behind_a_flipped_bit_all_chunks_are_read() {
    let dir = tempfile::tempdir().expect("a folder");
    let cycles: Vec<_> = (1..=6 * CHUNK as u64).map(record).collect();
    let path = recorded(dir.path(), &cycles);
    let bytes = std::fs::read(&path).expect("read");
    let mut chunks = Vec::new();
    rewritten(&bytes, |opcode, body| {
        let place = body.as_ptr() as usize - bytes.as_ptr() as usize;
        chunks.extend((opcode == mcap::records::op::CHUNK).then_some((place, body.len())));
        Vec::new()
    });
    assert!(chunks.len() >= 6, "{chunks:?}");
    // Damage to opcode, length (too short, beyond the end), sizes and name in the chunk header, and contents; of chunks at the
    // start, in the middle, and the last but one.
    for chunk in [0, 1, 3, chunks.len() - 2] {
        let (body, length) = chunks[chunk];
        for place in [
            body - 9,
            body - 8,
            body - 3,
            body + 16,
            body + 24,
            body + 32,
            body + 36,
            body + 41,
            body + length / 2,
        ] {
            let mut flipped = bytes.clone();
            flipped[place] ^= 0x40;
            std::fs::write(&path, flipped).expect("written");
            let (read_back, recording) =
                read(&path, Window::ALL).unwrap_or_else(|e| panic!("{chunk} {}: {e}", place - body));
            let at = format!("chunk {chunk}, byte {} of its body: {recording:?}", place as i64 - body as i64);
            assert!(recording.damage.is_some() && recording.cut.is_none(), "{at}");
            let lost = cycles.len() - read_back.len();
            assert!(lost <= CHUNK + 64, "{lost} cycles lost, {at}");
            assert!(read_back.windows(2).all(|pair| pair[0].seq < pair[1].seq), "{at}");
            assert_eq!(read_back.last(), cycles.last(), "{at}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_damage_panics(at in 0.0_f64..1.0, byte in any::<u8>(), cut in 0.0_f64..1.0) {
        let dir = tempfile::tempdir().expect("a folder");
        let path = recorded(dir.path(), &(1..=40).map(record).collect::<Vec<_>>());
        let mut bytes = std::fs::read(&path).expect("read");
        let i = (at * bytes.len() as f64) as usize;
        bytes[i] ^= byte;
        bytes.truncate((bytes.len() as f64 * (0.5 + cut)) as usize);
        std::fs::write(&path, bytes).expect("written");
        if let Ok((read_back, _)) = read(&path, Window::ALL) {
            prop_assert!(read_back.len() <= 40);
        }
    }
}

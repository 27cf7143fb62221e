//! Recognising a store: the witness beside it.

use super::{Folder, Robot, batch, config, on_each_engine, open, put_text};
use dbmanager::io::store::{Doubt, Engine, Store, Trust};
use dbmanager::logic::replica::{Config, Replica};
use std::fs;
use std::path::{Path, PathBuf};

/// Opens a store, writes to it, and returns its trust.
fn live(path: &Path) -> Trust {
    let mut store = open(path).unwrap();
    store.commit(&batch(&[(b"a", Some(vec![1]))])).unwrap();
    store.trust()
}

fn witness(folder: &Folder) -> PathBuf {
    folder.0.join("db.witness")
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() {
            copy(&from, &to);
        } else {
            fs::copy(from, to).unwrap();
        }
    }
}

#[test]
fn a_store_that_stays_is_trusted() {
    on_each_engine(|| {
        let folder = Folder::quick();
        assert_eq!(open(&folder.store()).unwrap().trust(), Trust::New);
        assert_eq!(live(&folder.store()), Trust::New, "nothing was written before");
        for _ in 0..3 {
            assert_eq!(live(&folder.store()), Trust::Kept);
            assert_eq!(open(&folder.store()).unwrap().trust(), Trust::Kept, "to look is no life");
        }
    });
}

#[test]
fn witness_missing_db_present() {
    on_each_engine(|| {
        let folder = Folder::quick();
        live(&folder.store());
        fs::remove_file(witness(&folder)).unwrap();
        assert_eq!(open(&folder.store()).unwrap().trust(), Trust::Doubtful(Doubt::Missing));
        assert_eq!(
            live(&folder.store()),
            Trust::Doubtful(Doubt::Missing),
            "the doubt stays until something is done about it"
        );
        assert_eq!(live(&folder.store()), Trust::Kept);
    });
}

/// A file that is not a witness cannot confirm the store. The next witness replaces it.
#[test]
fn a_witness_that_is_none() {
    on_each_engine(|| {
        for is_pipe in [false, true] {
            let folder = Folder::quick();
            live(&folder.store());
            if is_pipe {
                fs::remove_file(witness(&folder)).unwrap();
                rustix::fs::mknodat(rustix::fs::CWD, witness(&folder), rustix::fs::FileType::Fifo, 0o600.into(), 0)
                    .unwrap();
            } else {
                fs::write(witness(&folder), [b'a', 0xff, 0, b'\n']).unwrap();
            }
            assert_eq!(live(&folder.store()), Trust::Doubtful(Doubt::Damaged));
            assert_eq!(live(&folder.store()), Trust::Kept);
        }
    });
}

#[test]
fn a_backup_that_was_restored() {
    on_each_engine(|| {
        let folder = Folder::quick();
        live(&folder.store());
        let backup = folder.0.join("backup");
        copy(&folder.store(), &backup);
        live(&folder.store());
        fs::remove_dir_all(folder.store()).unwrap();
        copy(&backup, &folder.store());
        assert_eq!(live(&folder.store()), Trust::Doubtful(Doubt::Copied));
        // The bytes are put back into the same files, so the files are not new ones.
        copy(&folder.store(), &folder.0.join("backup2"));
        live(&folder.store());
        live(&folder.store());
        let sled = folder.store().join("records.sled");
        for entry in
            fs::read_dir(&sled).into_iter().flatten().map(Result::unwrap).filter(|entry| entry.path().is_file())
        {
            if !folder.0.join("backup2/records.sled").join(entry.file_name()).exists() {
                fs::remove_file(entry.path()).unwrap();
            }
        }
        copy(&folder.0.join("backup2"), &folder.store());
        assert_eq!(live(&folder.store()), Trust::Doubtful(Doubt::Restored));
    });
}

#[test]
fn a_store_of_another_robot() {
    on_each_engine(|| {
        let (one, other) = (Folder::quick(), Folder::quick());
        live(&one.store());
        live(&other.store());
        fs::remove_dir_all(one.store()).unwrap();
        fs::rename(other.store(), one.store()).unwrap();
        assert_eq!(live(&one.store()), Trust::Doubtful(Doubt::Another));
    });
}

#[test]
fn a_store_on_another_machine() {
    on_each_engine(|| {
        let folder = Folder::quick();
        live(&folder.store());
        let said = fs::read_to_string(witness(&folder)).unwrap();
        let elsewhere =
            said.lines().map(|line| if line.starts_with("machine ") { "machine 0123456789abcdef" } else { line });
        fs::write(witness(&folder), elsewhere.collect::<Vec<_>>().join("\n")).unwrap();
        assert_eq!(live(&folder.store()), Trust::Doubtful(Doubt::Moved));
        assert_eq!(live(&folder.store()), Trust::Kept);
    });
}

#[test]
fn a_crash_between_store_and_witness() {
    on_each_engine(|| {
        let folder = Folder::quick();
        live(&folder.store());
        let before = fs::read(witness(&folder)).unwrap();
        live(&folder.store());
        fs::write(witness(&folder), &before).unwrap();
        assert_eq!(live(&folder.store()), Trust::Kept, "the store is one life ahead");
        live(&folder.store());
        fs::write(witness(&folder), &before).unwrap();
        assert_eq!(live(&folder.store()), Trust::Doubtful(Doubt::Restored));
    });
}

#[test]
fn a_copy_begins_a_new_life_with_what_it_has() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
        robot.commit([put_text("team/a", "1")]).unwrap();
        let (origin, digest) = (robot.replica.origin(), robot.replica.state().digest());
        let records = robot.store.load().unwrap();
        let kept = Replica::open(config(), &records).unwrap();
        assert!(kept.origin() == origin && kept.is_member());
        let copied = Replica::open_copied(Config { seed: 2, ..config() }, &records).unwrap();
        assert!(copied.origin() != origin && !copied.is_member());
        assert_eq!(copied.state().digest(), digest);
    });
}

/// If an entry of a store is not a regular file, it is refused at once, by its own name. An engine would wait for a
/// pipe, or report the store as damaged.
#[test]
fn what_is_no_file_is_refused_by_its_name() {
    on_each_engine(|| {
        let folder = Folder::quick();
        assert_eq!(live(&folder.store()), Trust::New);
        let engine = Engine::of(&folder.store()).unwrap();
        let (data, aside) = (engine.data(&folder.store()), folder.0.join("data"));
        let refused = |what: &Path, why: &str| {
            let expected = format!("cannot use `{}`, where the store keeps a file: {why}", what.display());
            let error = open(&folder.store()).unwrap_err();
            assert!(error.to_string().starts_with(&expected) && !error.is_damage(), "{error}");
        };
        fs::remove_file(witness(&folder)).unwrap();
        for name in ["db.witness", "db.witness.new"] {
            let path = folder.0.join(name);
            fs::create_dir(&path).unwrap();
            refused(&path, "Is a directory");
            fs::remove_dir(&path).unwrap();
        }
        fs::rename(&data, &aside).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, &data, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        refused(&data, "it is a pipe; only regular files are written");
        fs::remove_file(&data).unwrap();
        std::os::unix::fs::symlink(folder.0.join("nothing"), &data).unwrap();
        let error = open(&folder.store()).unwrap_err().to_string();
        assert!(error.contains("it is a link that leads nowhere"), "{error}");
        fs::remove_file(&data).unwrap();
        fs::rename(&aside, &data).unwrap();
        assert_eq!(open(&folder.store()).unwrap().trust(), Trust::Doubtful(Doubt::Missing), "it is as it was");
    });
}

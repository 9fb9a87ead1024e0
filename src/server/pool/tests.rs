use super::*;
use crate::client::Client;
use crate::session::SessionId;
use std::sync::mpsc;

fn pool(queue: usize, wait: Duration) -> Pool {
    Pool::new(PoolConfig {
        workers: 1,
        queue,
        drag_wait: wait,
        upload_wait: wait,
    })
    .unwrap()
}

const LONG_WAIT: Duration = Duration::from_secs(600);

/// A session of one client.
fn key(n: u8) -> QueueKey {
    QueueKey::session(Client::default(), SessionId::from_bytes(&[n; 32]))
}

async fn drag(pool: &Pool, n: u8) -> Result<Ticket, PoolError> {
    pool.admit(WorkClass::Drag, key(n)).await
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_a_freed_place_is_given_again() {
    let pool = pool(1, LONG_WAIT);
    let first = drag(&pool, 1).await.unwrap();
    let waiting = tokio::spawn({
        let pool = pool.clone();
        async move { drag(&pool, 2).await }
    });
    while !pool.rejects(WorkClass::Drag, key(3)) {
        tokio::task::yield_now().await;
    }
    assert_eq!(drag(&pool, 3).await.unwrap_err(), PoolError::Full);
    assert_eq!(
        pool.load(WorkClass::Drag),
        Load {
            running: 1,
            waiting: 1,
            full: 1,
            late: 0
        }
    );
    pool.admit(WorkClass::Upload, key(3)).await.unwrap();
    waiting.abort();
    let _ = waiting.await;
    assert!(
        !pool.rejects(WorkClass::Drag, key(3)),
        "a waiter that left gives its place back"
    );
    drop(first);
    drag(&pool, 4).await.unwrap();
    assert_eq!(
        pool.load(WorkClass::Drag),
        Load {
            running: 0,
            waiting: 0,
            full: 1,
            late: 0
        }
    );
}

#[tokio::test]
async fn a_request_that_waits_too_long_is_told_and_leaves_nothing() {
    let pool = pool(8, Duration::from_millis(20));
    let first = drag(&pool, 1).await.unwrap();
    assert_eq!(
        drag(&pool, 2).await.unwrap_err(),
        PoolError::Late {
            max_wait: Duration::from_millis(20)
        }
    );
    assert_eq!(
        pool.load(WorkClass::Drag),
        Load {
            running: 1,
            waiting: 0,
            full: 0,
            late: 1
        }
    );
    drop(first);
    drag(&pool, 3).await.unwrap();
}

#[tokio::test]
async fn a_request_that_gives_way_to_another_is_told_at_once() {
    let pool = pool(2, LONG_WAIT);
    let first = drag(&pool, 1).await.unwrap();
    let wait = |n: u8| {
        let pool = pool.clone();
        tokio::spawn(async move { drag(&pool, n).await })
    };
    let mut same = Vec::new();
    for waiting in 1..=2 {
        same.push(wait(2));
        while pool.load(WorkClass::Drag).waiting < waiting {
            tokio::task::yield_now().await;
        }
    }
    let newcomer = wait(3);
    assert_eq!(same.remove(0).await.unwrap().unwrap_err(), PoolError::Full);
    drop(first);
    drop(same.remove(0).await.unwrap().unwrap());
    newcomer.await.unwrap().unwrap();
}

#[tokio::test]
async fn another_client_does_not_wait_for_the_end_of_a_long_request() {
    let pool = pool(0, LONG_WAIT);
    let (go, wait) = mpsc::channel::<()>();
    let long = drag(&pool, 1).await.unwrap();
    let (wait, began) = (
        Arc::new(Mutex::new(wait)),
        Arc::new(std::sync::atomic::AtomicUsize::new(0)),
    );
    let hold = {
        let began = Arc::clone(&began);
        move || {
            began.fetch_add(1, Ordering::Relaxed);
            let _ = wait.lock().map(|wait| wait.recv());
        }
    };
    long.start(hold);
    while began.load(Ordering::Relaxed) == 0 {
        tokio::task::yield_now().await;
    }
    let other = Client {
        address: [192, 0, 2, 1].into(),
        ..Client::default()
    };
    let ticket = pool
        .admit(WorkClass::Drag, QueueKey::client(other))
        .await
        .unwrap();
    assert_eq!(ticket.run(|_| 7).await, Ok(7), "it has a turn and a thread");
    assert!(pool.rejects(WorkClass::Drag, key(2)) && pool.is_full(WorkClass::Drag));
    drop((go, long, ticket));
}

/// A job that works until its request is dropped, and counts its looks.
fn endless(
    pool: &Pool,
    class: WorkClass,
    n: u8,
    looks: &Arc<std::sync::atomic::AtomicUsize>,
) -> tokio::task::JoinHandle<()> {
    let (pool, looks) = (pool.clone(), Arc::clone(looks));
    tokio::spawn(async move {
        let client = Client {
            address: [192, 0, 2, n].into(),
            ..Client::default()
        };
        let ticket = pool.admit(class, QueueKey::client(client)).await.unwrap();
        let work = move |cancel: &Cancel| {
            while !cancel.is_cancelled() {
                looks.fetch_add(1, Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        ticket.run(work).await.unwrap();
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_that_never_end_give_way_to_another_client_and_go_on() {
    give_way(WorkClass::Drag).await;
    give_way(WorkClass::Upload).await;
}

async fn give_way(class: WorkClass) {
    let pool = pool(8, LONG_WAIT);
    let looks: [Arc<std::sync::atomic::AtomicUsize>; 4] = Default::default();
    let jobs: Vec<_> = (0_u8..)
        .zip(&looks)
        .map(|(n, looks)| endless(&pool, class, n, looks))
        .collect();
    let seen = || looks.each_ref().map(|looks| looks.load(Ordering::Relaxed));
    // More than the permit and the spare one: they take turns.
    while seen().contains(&0) {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let ticket = pool.admit(class, key(9)).await.unwrap();
    assert_eq!(
        ticket.run(|_: &Cancel| 7).await,
        Ok(7),
        "there is a thread for it"
    );
    drop(ticket);
    let before = seen();
    while seen()
        .iter()
        .zip(before)
        .any(|(now, before)| *now == before)
    {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    jobs.iter().for_each(tokio::task::JoinHandle::abort);
    while pool.load(class).running > 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let (end, last) = (Instant::now(), seen());
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert!(
        seen() == last && end.elapsed() < LONG_WAIT,
        "paused jobs end when they are cancelled"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_for_which_the_permits_wait_goes_on_without_one() {
    let pool = pool(8, LONG_WAIT);
    let looks = Arc::default();
    let job = endless(&pool, WorkClass::Upload, 1, &looks);
    while looks.load(Ordering::Relaxed) == 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let client = |n: u8| {
        QueueKey::client(Client {
            address: [192, 0, 2, n].into(),
            ..Client::default()
        })
    };
    let spare = pool.admit(WorkClass::Upload, client(2)).await.unwrap();
    // It gets the job's permit, and keeps it.
    let held = pool.admit(WorkClass::Upload, client(3)).await.unwrap();
    let before = looks.load(Ordering::Relaxed);
    while looks.load(Ordering::Relaxed) <= before + 1 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(pool.load(WorkClass::Upload).running, 3);
    drop((spare, held));
    job.abort();
}

#[tokio::test]
async fn a_panic_ends_its_own_work_alone() {
    let pool = pool(0, LONG_WAIT);
    let ticket = drag(&pool, 1).await.unwrap();
    assert_eq!(
        ticket.run(|_| panic!("on purpose")).await.map(|()| 0),
        Err(PoolError::Panicked)
    );
    assert_eq!(ticket.run(|_| 7).await, Ok(7));
}

#[tokio::test]
async fn a_dropped_request_cancels_its_work_and_keeps_its_turn_until_the_work_has_ended() {
    let pool = pool(0, LONG_WAIT);
    let (seen, sees) = mpsc::channel();
    let (go, wait) = mpsc::channel::<()>();
    let task = tokio::spawn({
        let pool = pool.clone();
        async move {
            let ticket = drag(&pool, 1).await.unwrap();
            ticket
                .run(move |cancel| {
                    seen.send("began").unwrap();
                    wait.recv().unwrap();
                    seen.send(if cancel.is_cancelled() {
                        "cancelled"
                    } else {
                        "wanted"
                    })
                    .unwrap();
                })
                .await
        }
    });
    let sees = tokio::task::spawn_blocking(move || {
        assert_eq!(sees.recv().unwrap(), "began");
        sees
    });
    let sees = sees.await.unwrap();
    task.abort();
    assert!(task.await.unwrap_err().is_cancelled());
    assert!(
        pool.rejects(WorkClass::Drag, key(1)),
        "the work holds the client's only place"
    );
    go.send(()).unwrap();
    let seen = tokio::task::spawn_blocking(move || sees.recv().unwrap());
    assert_eq!(seen.await.unwrap(), "cancelled");
    while pool.rejects(WorkClass::Drag, key(1)) {
        tokio::task::yield_now().await;
    }
}

// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// @title Payment for what UAVs relay: a deposit, receipts signed in flight, one settlement for each vehicle and period
/// @notice The price of a full period is what the vehicle proposed to SkyRelay: its payment [cents per Mbit/s] times its
/// demand [kbit/s], in the unit of `Credit`. A receipt says how much of it is due so far; the greatest settles.
interface ISkyRelayPayments {
    /// @notice The vehicle owes the UAV `amount` so far for one period of a zone, by the vehicle's signature.
    /// @param vs s, with the parity of v in its first bit (EIP-2098).
    struct Receipt {
        address vehicle;
        uint32 zone;
        uint32 period;
        uint96 amount;
        bytes32 r;
        bytes32 vs;
    }

    /// @param free can be locked or withdrawn.
    /// @param leaving waits to be withdrawn, from `leavesAt` [s] on; can be locked until it is.
    struct Account {
        uint96 free;
        uint96 leaving;
        uint40 leavesAt;
    }

    /// @param locked of the vehicle's deposit: the price of the period; 0 once it is settled.
    /// @param claimed what the vehicle says is due, where `hasClaimed`.
    /// @param deadline until when receipts are taken [s].
    struct Agreement {
        address uav;
        uint32 zone;
        uint32 period;
        uint96 locked;
        uint96 claimed;
        uint40 deadline;
        bool hasClaimed;
    }

    event Deposited(address indexed account, address indexed from, uint96 amount);
    event WithdrawalRequested(address indexed account, uint96 leaving, uint40 leavesAt);
    event Withdrawn(address indexed account, uint96 amount);
    /// @notice The price is locked: the UAV can serve.
    event AgreementOpened(
        address indexed vehicle, address indexed uav, uint32 zone, uint32 period, uint96 price, uint40 deadline
    );
    /// @notice A vehicle was selected for a price that it has not deposited: what it has is the UAV's.
    event DepositForfeited(
        address indexed vehicle, address indexed uav, uint32 zone, uint32 period, uint96 price, uint96 forfeited
    );
    /// @notice A vehicle says that no more is due: the UAV has until the deadline for a receipt of more.
    event Claimed(
        address indexed vehicle, address indexed uav, uint32 zone, uint32 period, uint96 amount, uint40 deadline
    );
    /// @param penalty of a vehicle that had claimed less than it had signed.
    event Settled(
        address indexed vehicle, address indexed uav, uint32 zone, uint32 period, uint96 paid, uint96 penalty
    );

    /// @notice A time of 0, or no contract where there should be one.
    error InvalidTerms();
    /// @notice An amount of 0.
    error NothingToMove();
    error InsufficientDeposit(uint96 free, uint96 asked);
    /// @notice The withdrawal waits until this time [s].
    error NotYet(uint40 leavesAt);
    /// @notice None of this vehicle for this UAV, zone and period that is open.
    error NoAgreement(address vehicle, address uav, uint32 zone, uint32 period);
    error Expired(uint40 deadline);
    error MoreThanAgreed(uint96 amount, uint96 locked);
    /// @notice The vehicle has claimed already.
    error AlreadyClaimed(uint96 claimed);
    /// @notice The receipt is not its vehicle's.
    error WrongSignature(address vehicle);

    /// @notice Pay into an account, one's own or another's. The token's allowance is the caller's.
    function deposit(address account, uint96 amount) external;

    /// @notice Begin to withdraw; what waits already waits anew with it.
    function requestWithdrawal(uint96 amount) external;

    /// @notice Take out what has waited.
    function withdraw() external;

    /// @notice As a UAV: lock the price of the present period for each vehicle that it has selected.
    /// @return opened agreements. A vehicle whose agreement is open already is passed by, and so is one with two others
    /// that are not over: serve nobody without an agreement.
    function open() external returns (uint256 opened);

    /// @notice As a UAV: hand in the greatest receipt of each vehicle. What it says is paid, the rest is the vehicle's
    /// again; all of the price where the vehicle had claimed less.
    function settle(Receipt[] calldata receipts) external;

    /// @notice As a vehicle that wants its rest sooner: say what is due to a UAV for a period. It is settled so when the window is
    /// over, unless the UAV has a receipt of more: then all of the price is the UAV's.
    function claim(address uav, uint32 zone, uint32 period, uint96 amount) external;

    /// @notice Settle the agreements of these vehicles whose time is over: by the claim, or for nothing.
    function close(address[] calldata vehicles) external;

    function accountOf(address member) external view returns (Account memory);

    /// @notice A vehicle's two latest agreements, in no order; one whose `locked` is 0 is settled.
    function agreementsOf(address vehicle) external view returns (Agreement[2] memory);

    /// @notice What the vehicle of an agreement signs (EIP-712).
    function receiptHash(address vehicle, address uav, uint32 zone, uint32 period, uint96 amount)
        external
        view
        returns (bytes32);
}
